"""Figures of the report: labels, data, axes, stepsizes, reference slopes."""

from fractions import Fraction

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from cg.integration import integrate
from cg.problems import HeavyTop
from cg.reproduce import top
from cg.reproduce.blocks import Chart, Table
from cg.reproduce.sections import fig4_1, fig4_2, fig4_2_quad, search
from cg.reproduce.style import LINES

METHODS = ("CG4", "CG4a", "CG5a", "CG6a")
ORDERS = dict(zip(METHODS, (4, 4, 5, 6), strict=True))


def charts(blocks):
    return {block.name: block for block in blocks if isinstance(block, Chart)}


def drawn(chart):
    figure = Figure(figsize=chart.size)
    chart.draw(figure)
    return figure


def curves(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def legend(figure):
    """Labels of the legend with the colours and styles that stand beside them."""
    (actual,) = figure.legends
    return {
        text.get_text(): (to_hex(handle.get_color()), handle.get_linestyle(), handle.get_marker())
        for text, handle in zip(actual.get_texts(), actual.legend_handles, strict=True)
    }


def look(line):
    return to_hex(line.get_color()), line.get_linestyle(), line.get_marker()


def slope(line):
    x, y = (np.log(np.asarray(values, dtype=float)) for values in line.get_data())
    local = np.diff(y) / np.diff(x)
    assert np.ptp(local) < 1e-9  # straight
    return local[0]


def check_methods(figure, axes, x, expected):
    """Each method's curve has its data, its own style, and the same style in the legend."""
    actual, shown = curves(axes), legend(figure)
    for method, y in expected.items():
        line = actual[method]
        np.testing.assert_array_equal(line.get_xdata(), x)
        np.testing.assert_array_equal(line.get_ydata(), y)
        assert look(line) == shown[method]
    assert len({shown[method] for method in expected}) == len(expected)


@pytest.fixture
def errors_over_time():
    t = [0.0, 0.5, 1.0]
    readings = {
        reading: {
            "reference_error": 1e-40,
            "methods": {
                method: {
                    "rotation": [1e-17, (k + 1) * 10.0**-r, (k + 2) * 10.0**-r],
                    "momentum": [1e-17, (k + 3) * 10.0**-r, (k + 4) * 10.0**-r],
                }
                for k, method in enumerate(METHODS)
            },
        }
        for r, reading in enumerate(top.READINGS, 3)
    }
    return {"h": 0.1, "t": t, "readings": readings}


@pytest.mark.parametrize("reading", top.READINGS)
def test_figure_4_1(errors_over_time, reading):
    blocks = fig4_1.present(errors_over_time)
    chart = charts(blocks)[f"fig4.1-{reading}"]
    assert top.READINGS[reading] in chart.caption
    assert "h = 0.1" in chart.caption
    figure = drawn(chart)
    runs = errors_over_time["readings"][reading]["methods"]
    for axes, key, name in zip(figure.axes, ("rotation", "momentum"), "Bω", strict=True):
        expected = {method: run[key][1:] for method, run in runs.items()}
        check_methods(figure, axes, [0.5, 1.0], expected)
        assert axes.get_title(loc="left") == f"Component {name}(t)"
        assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "log")
        low, high = axes.get_ylim()
        assert low < min(map(min, expected.values())) < max(map(max, expected.values())) < high
    (table,) = (block for block in blocks if isinstance(block, Table))
    for row in table.rows:
        ends = [
            errors_over_time["readings"][r]["methods"][row[0]][key][-1]
            for r in top.READINGS
            for key in ("rotation", "momentum")
        ]
        assert [float(cell.replace("−", "-")) for cell in row[1:]] == pytest.approx(ends)
    assert table.header[1:] == ("B, momentum", "ω, momentum", "B, velocity", "ω, velocity")


def errors_by_step(h):
    return {method: [10.0**-k * size ** ORDERS[method] for size in h]
            for k, method in enumerate(METHODS)}  # fmt: skip


@pytest.mark.parametrize("reading", top.READINGS)
def test_figure_4_2(reading):
    h, t = [0.25, 0.125, 0.0625, 0.03125], [0.0, 0.5, 1.0]
    readings = {
        name: {
            method: {
                "distance": [1e-17, (k + 1) * 1e-17, (k + 2) * 1e-17],
                "distance_flows": [1e-17, (k + 3) * 1e-17, (k + 4) * 1e-17], "long_distance": 1e-16,
                "long_distance_flows": 2e-16, "error": error, "slope": float(ORDERS[method]),
                "fitted": 3,
            }
            for k, (method, error) in enumerate(errors_by_step([x * y for x in h]).items())
        }
        for y, name in enumerate(top.READINGS, 1)
    }  # fmt: skip
    references = dict.fromkeys(top.READINGS, 1e-40)
    data = {"h": h, "t": t, "long_h": 0.005, "reference_error": references, "readings": readings}
    chart = charts(fig4_2.present(data))[f"fig4.2-{reading}"]
    assert top.READINGS[reading] in chart.caption
    figure = drawn(chart)
    left, middle, right = figure.axes
    runs = readings[reading]
    for axes, key, how in (
        (left, "distance", "with a step towards it"),
        (middle, "distance_flows", "flows alone"),
    ):
        check_methods(figure, axes, t, {method: run[key] for method, run in runs.items()})
        assert how in axes.get_title(loc="left")
        assert (axes.get_xscale(), axes.get_yscale()) == ("linear", "log")
        assert set(curves(axes)["roundoff of double"].get_ydata()) == {2.0**-53}
    assert left.get_ylim() == middle.get_ylim()
    check_methods(figure, right, h, {method: run["error"] for method, run in runs.items()})
    assert (right.get_xscale(), right.get_yscale()) == ("log", "log")
    line = curves(right)["order 4"]
    np.testing.assert_array_equal(line.get_xdata(), h)
    assert slope(line) == pytest.approx(4)
    assert look(line) == legend(figure)["order 4"] == ("#000000", "-", "None")
    assert set(legend(figure)) == {*METHODS, "order 4", "roundoff of double"}


def test_figure_4_2_in_quad():
    h = [2.0**-k for k in range(2, 8)]
    runs = {}
    for method, error in errors_by_step(h).items():
        order = float(ORDERS[method])
        slopes = {"local": [order] * (len(h) - 1), "slope": order, "largest_slope": order}
        runs[method] = {"h": h, "error": error, **slopes}
    data = {"readings": {"momentum": {"reference_error": 1e-40, "methods": runs}}}
    figure = drawn(charts(fig4_2_quad.present(data))["fig4.2-quad-momentum"])
    (axes,) = figure.axes
    check_methods(figure, axes, h, {method: run["error"] for method, run in runs.items()})
    for order in (4, 5, 6):
        assert slope(curves(axes)[f"order {order}"]) == pytest.approx(order)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    guides = {f"order {q}" for q in (4, 5, 6)}
    assert set(legend(figure)) == {*METHODS, *guides, "roundoff of double"}


def test_figure_of_a_search():
    f_double, f_quad = [1e-3, 1e-9, 1e-30, 1e-33], [None, None, 1e-60, 1e-69]
    data = {
        "f_double": f_double, "f_quad": f_quad, "paper": {"f_double": 1e-15, "f_quad": 1e-31},
        "exact": [False, False, True, True],
        "f_double_quartiles": [1e-33, 1e-33, 1e-30, 1e-9, 1e-3],
        "f_quad_quartiles": [1e-69, 1e-69, 1e-60, 1e-60, 1e-60],
        "settings": {"width": 1, "seed": 0, "maxfev": 9, "refine_below": 1e-12, "refine_maxfev": 9},
        "at_limit": 1, "distinct": 2,
        "abscissae_in_unit_interval": 0, "methods": [],
        "best": {"f": 1e-69, "max_residual": 1e-35, "coefficients": []},
    }  # fmt: skip
    blocks = search.present(search.PLANS[4], data)
    (axes,) = drawn(charts(blocks)["search4"]).axes
    actual = curves(axes)
    np.testing.assert_array_equal(actual["after double, 4 starts"].get_xdata(), sorted(f_double))
    np.testing.assert_array_equal(
        actual["after double, 4 starts"].get_ydata(), [0.25, 0.5, 0.75, 1]
    )
    np.testing.assert_array_equal(actual["after real(16), 2 starts"].get_xdata(), [1e-69, 1e-60])
    np.testing.assert_array_equal(actual["after real(16), 2 starts"].get_ydata(), [0.5, 1])
    assert set(actual["paper, after double: 1e−15"].get_xdata()) == {1e-15}
    assert set(actual["paper, after real(16): 1e−31"].get_xdata()) == {1e-31}
    assert axes.get_xscale() == "log"
    (table,) = (block for block in blocks if isinstance(block, Table) and "phase" in block.header)
    assert list(table.rows[0])[-2:] == ["3.2e−17", "1e−15"]


def test_stepsizes_and_times_match_the_paper():
    assert fig4_1.STEPS == 10
    h = [1 / steps for steps in fig4_2._STEPS]
    assert 0.1 in h
    assert h == sorted(h, reverse=True)
    assert h[0] / h[-1] == 512
    assert top.METHODS == METHODS == tuple(LINES)


def test_errors_match_their_stepsizes():
    reading, method, steps = "velocity", "CG5a", 10
    problem = HeavyTop(reading)
    exact = np.array([float(x) for x in problem.reference([Fraction(1)]).values[0]])
    y0, h = problem.y0, 1 / steps
    end = integrate(problem.f, (0.0, 1.0), y0, frame=problem.frame, method=method, h=h).y[-1]
    rotation = np.linalg.norm((end - exact)[:9].reshape(3, 3), 2)
    assert top.end_error(reading, method, steps) == pytest.approx(rotation, rel=1e-9)
    over_time = top.errors(reading, method, steps)
    assert over_time.rotation[-1] == pytest.approx(rotation, rel=1e-9)
    assert over_time.momentum[-1] == pytest.approx(np.linalg.norm((end - exact)[9:]), rel=1e-9)
    assert over_time.t == pytest.approx([k / steps for k in range(steps + 1)])


def test_flow_distances_use_the_same_steps():
    distance = top.flow_distances("momentum", "CG4a", 10)
    assert len(distance) == 11
    assert 1e-17 < distance[-1] < 2e-15
    again = top.flow_distances("momentum", "CG4a", 40)
    assert distance[-1] < again[-1] < 1e-14  # rounding adds up: nothing takes it away


def test_distance_detects_points_off_the_group():
    rotation = np.eye(3)
    rotation[0, 1] = 1e-7
    assert top.off_group(rotation.ravel().tolist()) == pytest.approx(0.5e-7, rel=1e-6)
    assert top.off_group((1.25 * np.eye(3)).ravel().tolist()) == (1.25**2 - 1) / 2
