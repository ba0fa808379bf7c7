"""Tables and figures of the papers behind this project, published beside own."""
