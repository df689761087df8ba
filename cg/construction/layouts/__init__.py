"""Where the points, stages and coefficients of a method stand."""
