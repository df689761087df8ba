"""Members of ensembles against their own solutions."""

import itertools

import numpy as np

import cg

COUNTS = ("steps", "nrejected", "nfev", "nexp", "njev", "nlu", "status", "success")


def members_alone(f, span, y0, parameters=None, **options):
    """Return each member's own solution, at the ends of the span unless times are wanted."""
    options.setdefault("t_eval", list(dict.fromkeys(span)))
    rows = itertools.repeat(None) if parameters is None else parameters
    return [
        cg.solve_ivp(f, span, point, parameters=row, **options)
        for point, row in zip(y0, rows, strict=False)
    ]


def check(ensemble, apart, *, atol=0.0):
    """Check that members of an ensemble are their own solutions."""
    assert len(ensemble) == len(apart)
    assert ensemble.y.shape == (len(ensemble.t), len(apart), *ensemble.frame.point_shape)
    assert not ensemble.y.flags.writeable
    assert not ensemble.t.flags.writeable
    for i, alone in enumerate(apart):
        member = ensemble[i]
        same(member.t, alone.t, atol)
        same(member.y, alone.y, atol)
        n = len(alone.t)
        same(ensemble.y[:n, i], alone.y, atol)
        assert np.isnan(ensemble.y[n:, i]).all()
        for count in COUNTS:
            assert getattr(member, count) == getattr(alone, count)
            if count != "success":
                assert getattr(ensemble, count)[i] == getattr(alone, count)
        assert (member.method, member.frame, member.h) == (alone.method, alone.frame, alone.h)
        assert member.message == alone.message
        assert (member.t_events is None) == (alone.t_events is None)
        for name in ("t_events", "y_events", "y_after"):
            for j, expected in enumerate(getattr(alone, name) or ()):
                same(getattr(member, name)[j], expected, atol)
                same(getattr(ensemble, name)[j][i], expected, atol)
        assert (member.sol is None) == (alone.sol is None)
        if alone.sol is not None:
            same(member.sol.ts, alone.sol.ts, 1e4 * atol)
            ends = np.sort([member.sol.t_min, member.sol.t_max])
            where = np.linspace(*ends, 11)
            same(
                member.sol(where), alone.sol(np.clip(where, alone.sol.t_min, alone.sol.t_max)), atol
            )
            same(ensemble.sol(where)[:, i], member.sol(where), 0.0)


def same(actual, expected, atol):
    assert actual.dtype == expected.dtype
    assert actual.shape == expected.shape
    if atol:
        np.testing.assert_allclose(actual, expected, rtol=0, atol=atol)
    else:
        np.testing.assert_array_equal(actual, expected)
