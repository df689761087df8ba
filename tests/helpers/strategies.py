"""What hypothesis draws in the tests of more than one module."""

from fractions import Fraction

from hypothesis import strategies as st

from cg.construction.layouts import Layout, Rows
from cg.construction.points import START, Point, PointTree
from cg.construction.trees import OrderedTree

trees = st.recursive(
    st.just(OrderedTree()),
    lambda subtrees: st.lists(subtrees, max_size=4).map(
        lambda children: OrderedTree(tuple(children))
    ),
    max_leaves=12,
)

# dyadic, so that doubles and quads hold them exactly
dyadics = st.integers(-32, 32).map(lambda k: Fraction(k, 16))
rationals = st.fractions(min_value=-3, max_value=3, max_denominator=60)


@st.composite
def tableaux(draw, entries=dyadics, max_stages=4):
    """Draw (a, b), as lists of Fractions, of any of the patterns."""
    stages = draw(st.integers(1, max_stages))
    rows = draw(st.sampled_from(Rows))
    layout = Layout.tableau(stages, rows)
    lengths = [len(layout.row(r)) for r in range(stages + 1)]
    a = [
        draw(st.lists(entries, min_size=length, max_size=length))
        + [Fraction(0)] * (stages - length)
        for length in lengths[:-1]
    ]
    return a, draw(st.lists(entries, min_size=stages, max_size=stages))


@st.composite
def point_trees(draw, entries=dyadics, max_points=7):
    """Draw the points of an explicit method, some of them stages, with one or more weights each.

    Prefixes are shared, and some points are on no path.
    """
    points, stages = [], [START]
    nonzero = entries.filter(bool)
    for m in range(draw(st.integers(1, max_points))):
        parent = draw(st.integers(START, m - 1))
        used = draw(st.sets(st.integers(0, len(stages) - 1), min_size=1, max_size=3))
        points.append(Point(parent, {stage: draw(nonzero) for stage in sorted(used)}))
        if draw(st.booleans()):
            stages.append(draw(st.integers(START, m)))
    return PointTree(tuple(points), tuple(stages), draw(st.integers(0, len(points) - 1)))
