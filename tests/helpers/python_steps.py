"""Steps of methods, their errors and their choice, one flow at a time, all in Python."""

import copy
from dataclasses import dataclass
from functools import cache

import numpy as np

from cg.construction.methods.compile import error_exponent
from cg.construction.methods.paths import paths_of
from cg.construction.methods.reference_step import take_paths
from cg.support.shared_numbers import EstimateForm


class Step:
    """Steps of a method; those of an explicit one count what they take."""

    def __init__(self, f, frame, method):
        self.f, self.frame, self.method = f, frame, method
        self.paths = paths_of(method)
        self.nfev = self.nexp = 0
        self._known = []  # times, points and coefficients at the ends of the last step

    def __call__(self, t, y, h):
        return self._take(t, y, h, [self.paths.result])[0]

    def pair(self, t, y, h):
        """Return both results, the one that advances first."""
        return tuple(self._take(t, y, h, [self.paths.result, self.paths.embedded]))

    def trial(self, t, y, h, rtol, atol):
        """Return the result and its error in tolerances."""
        if self.paths.estimate > EstimateForm.AT_END:
            return self._trial_in_parts(t, y, h, rtol, atol)
        errors = []
        if self.paths.embedded:
            y1, other = self.pair(t, y, h)
            errors.append(error(self.frame, other, y1, y, rtol, atol))
        else:
            y1 = self(t, y, h)
        errors += self.estimates(y, h, y1, rtol, atol)
        if self.paths.estimate is EstimateForm.AT_END:
            end = errors[1] if len(errors) == 2 else errors[1] ** 2 / np.hypot(*errors[1:])
            return y1, max(errors[0], float(self.paths.factor) * end)
        (single,) = errors
        return y1, single

    def _trial_in_parts(self, t, y, h, rtol, atol):
        """Return the same by two differences, that of quadratures and the rest of each."""
        paths = self.paths
        results = [paths.result, *(path for path in (paths.embedded, paths.third) if path)]
        y1, *others = self._take(t, y, h, results)
        sums = self._sums(h, y1, self.values)
        if paths.series:
            rests = [a - b for a, b in zip(self._sums(h, y1, self.fields), sums, strict=True)]
        else:
            whole = [difference(self.frame, other, y1) for other in others]
            rests = [a - b for a, b in zip(whole, (sums[0], sums[-1]), strict=True)]
        scale, larger = _scale(self.frame, [y, y1], rtol, atol), 0.0
        for part in (sums, rests):
            *first, last = (_rms(v / scale) for v in part)
            if e1 := max(first):
                larger = max(larger, e1**2 / np.hypot(e1, 0.1 * last))
        return y1, larger

    def estimates(self, y, h, y1, rtol, atol):
        """Return the errors in tolerances that combinations of stages of the last step tell."""
        scale = _scale(self.frame, [y, y1], rtol, atol)
        return [_rms(v / scale) for v in self._sums(h, y1, self.fields)]

    def _sums(self, h, y1, values):
        """Return combinations of stages as tangents at the result, in coordinates if there are."""
        weights = np.array(self.paths.errors, dtype=float).reshape(-1, len(values))
        tangents = [self.frame.without_isotropy(v, y1) for v in h * weights @ np.array(values)]
        if self.frame.exp_coordinates(y1, y1) is not None:
            return tangents
        return [self.frame.field(v, y1) for v in tangents]

    def _take(self, t, y, h, results):
        paths, known, self.values = self.paths, self._known, []

        def value(k, point, u):
            at_ends = [v for at, end, v in known if point is end and abs(t - at) < 1e-12]
            if k == 0 and at_ends:
                (v,) = at_ends
            else:
                v = np.asarray(self.f(t + float(paths.c[k]) * h, point), dtype=float)
                self.nfev += 1
            self.values.append(v)  # coefficients, on the algebra before dexpinv
            if not paths.series or u is None:
                return v
            return self.frame.dexpinv(u, v, order=paths.series)

        def flow(terms, values, point):
            self.nexp += 1
            u = sum(h * float(weight) * values[k] for k, weight in terms)
            return self.frame.flow(u, point), u

        values = []
        if not self.method.explicit:
            start = np.asarray(self.f(t, y), dtype=float)
            values, change = [start for _ in paths.stages], 1.0
            for _ in range(200):
                if change < 1e-15:
                    break
                ends, before = take_paths(paths, y, value, flow, values)
                values = [value(k, *ends[path]) for k, path in enumerate(paths.stages)]
                change = np.abs(np.subtract(values, before)).max()
            assert change < 1e-13
        ends, self.fields = take_paths(paths, y, value, flow, values)
        actual = [ends[path][0] for path in results]
        self._known = [(t, y, self.fields[0])]
        if paths.final_stage and self.method.explicit:
            self._known.append((t + h, actual[0], self.values[paths.final_stage - 1]))
        return actual


@dataclass
class Steps:
    """Steps that were chosen by errors, with what they took."""

    times: list
    y: object
    rejected: int
    nfev: int
    nexp: int


def choose_steps(f, span, y0, *, frame, method, first_step, rtol=1e-3, atol=1e-6):
    """Return the steps of a pair by Gustafsson's control."""
    (t, stop), y, step = span, y0, Step(f, frame, method)
    sign, exponent = np.sign(stop - t), error_exponent(method)
    actual, size, last, after_rejection = Steps([t], y0, 0, 0, 0), first_step, 1.0, False
    suspicion = 0
    while t != stop:
        expected = size
        shortened = sign * (t + sign * size - stop) >= 0.0
        end = stop if shortened else t + sign * size
        taken = abs(end - t)
        y1, err = step.trial(t, y, end - t, rtol, atol)
        if suspicion > 4:
            err *= 20.0
        if not err <= 1.0:
            size = taken * (max(0.2, 0.9 * err**-exponent) if np.isfinite(err) else 0.25)
            actual.rejected, after_rejection = actual.rejected + 1, True
            suspicion = min(suspicion + 4, 12)
            continue
        factor = 5.0
        if err > 0.0:
            factor = min(5.0, max(0.2, 0.9 * (err**-0.7 * last**0.4) ** exponent))
        size = taken * (min(factor, 1.0) if after_rejection else factor)
        if shortened and not after_rejection:
            size = max(size, expected)
        t, y, last, after_rejection = end, y1, max(err, 1e-4), False
        suspicion = max(suspicion - 1, 0)
        actual.times.append(t)
    actual.y, actual.nfev, actual.nexp = y, step.nfev, step.nexp
    return actual


def error(frame, other, y1, y, rtol, atol):
    """Return the difference of two results in tolerances."""
    return _rms(difference(frame, other, y1) / _scale(frame, [y, y1], rtol, atol))


def difference(frame, other, y1):
    """Return coordinates of a point from another one, or else the difference of both."""
    coordinates = frame.exp_coordinates(other, y1)
    return y1 - other if coordinates is None else coordinates


def _scale(frame, points, rtol, atol):
    if frame.exp_coordinates(points[0], points[0]) is None:
        sizes = [_rms(y) for y in points]
    else:
        sizes = [frame.coordinate_sizes(y) for y in points]
    return np.maximum(atol + rtol * np.maximum(*sizes), np.finfo(float).tiny)


def _rms(values):
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def uncompiled(frame):
    """Return a frame that does the same in Python alone."""
    copied = copy.copy(frame)
    object.__setattr__(copied, "__class__", _kind(type(frame)))
    if "group" in vars(copied):
        vars(copied)["group"] = uncompiled(copied.group)
    return copied


@cache
def _kind(kind):
    return type(kind.__name__, (kind,), {"compiled_blocks": lambda self: None})
