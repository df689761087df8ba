"""Helpers of all other parts: argument checks, parsing, quadruple precision, parallel calls."""
