"""A ball that falls on a floor and bounces."""

GRAVITY, KEPT = 9.81, 0.9


def fall(t, y):
    return [y[1], -GRAVITY]


def height(t, y):
    return y[0]


def bounce(t, y):
    return [0.0, -KEPT * y[1]]
