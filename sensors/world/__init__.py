"""The world that cameras on trailers see: ground, scenery, traffic, sky and light."""
