"""A slow, simple model of the integrators, and random programs that are compared with it."""
