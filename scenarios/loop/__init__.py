"""The closed loop, step by step, of trailers and rovers."""
