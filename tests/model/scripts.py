"""Texts that are run behind the script of a program."""

CALL = "s = cg.solve_ivp(f, span, y0, **options)"
OBSERVED = """calls = [0]
def counted(*arguments):
    calls[0] += 1
    return f(*arguments)
def observe(t, y, *rest): return [t, float(np.abs(y).sum())]
s = cg.solve_ivp(NAME, span, y0, **options, observe=observe, store=STORE)"""
TOGETHER = """def together(event):
    def rows(t, y, *rest):
        rest = [zip(*each) if isinstance(each, tuple) else each for each in rest]
        return np.array([event.function(*one) for one in zip(t.tolist(), y, *rest)])
    return cg.Event(rows, event.terminal, event.direction, event.jump, event.period, True)
many = {"events": [event if event.direction > 0 else together(event)
                   for event in options.get("events", ())]}
"""
POOL = """import concurrent.futures, multiprocessing
pool = globals().get("pool") or concurrent.futures.ProcessPoolExecutor(
    1, multiprocessing.get_context("fork"))
"""
EVENTS_TOGETHER = (" | many", " | many, vectorized=True")
VECTORIZED = (", vectorized=True", ", vectorized=True, workers=2")
STEPPING = """others = "t_eval dense_output linear derivatives control_derivatives P0 noise".split()
def kept(options): return {k: v for k, v in options.items() if k not in others}
stepping = kept(options)
g = python if "linear" in options else f
"""
STEPPER = f"{STEPPING}s = cg.Stepper(g, span[0], y0, span[1], **stepping)\n"
STEPS = """t, y, middles = [s.t], [s.y], []
while s.status == "running":
    message = s.step()
    assert s.status != "failed", message
    t, y = [*t, s.t], [*y, s.y]
    if DENSE and not s.stopped.all():
        middles.append((~s.stopped, (s.t + s.t_old) / 2, s.dense_output()))
    if len(t) % 3 == 2 and s.status == "running":
        twin = copy.copy(s) if COPIES or len(t) % 2 else pickle.loads(pickle.dumps(s))
        if len(t) % 4 == 1:
            s.step()
        s = twin
"""
MEMBERS = f"""{STEPPING}ys, equal = np.stack([y0, other, y0]), np.testing.assert_equal
e = cg.solve_ensemble(g, span, ys, **kept(several)WAY, dense_output=DENSE, common_steps=COMMON)
s = cg.Stepper(g, span[0], ys, span[1], **kept(several)WAY, common_steps=COMMON)
"""
AS_ENSEMBLE = """equal(s.stopped, e.status == 1)
equal([getattr(s, name) for name in EVENTS], [getattr(e, name) for name in EVENTS])
equal(s.y[~s.stopped], e.y[-1, ~s.stopped])
if not DENSE:
    counts = [getattr(s, name) for name in EVALUATIONS]
    equal(counts, [getattr(e, name).sum() for name in EVALUATIONS])
"""
COMMON_STEPS = f"""COMMON = True\n{MEMBERS}{STEPS}{AS_ENSEMBLE}
for rows, t, output in middles:
    equal(output(t)[rows], e.sol(t)[rows])
"""
OWN_STEPS = f"COMMON = False\n{MEMBERS}s.advance(span[1])\n{AS_ENSEMBLE}"
SINGLE = f"""COMMON = False\n{MEMBERS}
def lead(s, y, data):
    points, data = [], {{k: data[k] for k in ("inputs", "parameters") if k in data}}
    for k, goal in enumerate(GOALS):
        if k == 1 and s.status == "running":
            s.restart(**data)
            s, twin = copy.copy(s) if COPIES else pickle.loads(pickle.dumps(s)), s
            twin.advance(goal)
        if k == 2: s.restart(t=GOALS[0], y=y, **data)
        if k == 3: s.restart(y=s.y, **again)
        assert s.status != "running" or not s.advance(goal) or s.status == "event", s
        points.append(s.y)
    return s, points
events = options.get("events", ())
again = {{"t": GOALS[2]}} if any(event.terminal for event in events) else {{}}
own = [options, second, options]
singles, courses = zip(*(
    lead(cg.Stepper(g, span[0], ys[i], span[1], **kept(own[i])), ys[int(i == 0)], own[1 - i % 2])
    for i in range(3)))
s, points = lead(s, ys[[1, 0, 0]], swapped)
equal(points, list(map(np.stack, zip(*courses))))
for name in EVENTS:
    equal(getattr(s, name), list(map(list, zip(*(getattr(single, name) for single in singles)))))
if not any(event.jump or event.terminal for event in events):  # where single ones interpolate
    equal([getattr(s, name) for name in EVALUATIONS],
          [sum(getattr(single, name) for single in singles) for name in EVALUATIONS])
"""
GOALS = """y = []
for goal in GOALS:
    message = s.advance(goal)
    assert s.t == goal, message
    y.append(s.y)
    s.restart(y=s.y)
"""
JAX = """import types, diffrax, jax
jax.config.update("jax_enable_x64", True)
traced = types.FunctionType(f.__code__, {**f.__globals__, "np": jax.numpy})
@jax.jit
def points(p):
    return diffrax.diffeqsolve(
        cg.jax.FrameTerm(lambda t, y, p: traced(t, y, *p), frame), cg.jax.Solver(options["method"]),
        *span, None, jax.numpy.asarray(y0), args=p, max_steps=4096,
        stepsize_controller=cg.jax.controller(frame, options["rtol"], options["atol"]),
        saveat=diffrax.SaveAt(ts=np.linspace(*span, 4)[1:])).ys
y, slope = points(REST), jax.vjp(points, REST)[1]"""
SCIPY = """import cg.scipy, scipy.integrate
def slope(t, z, *rest):
    y = z.reshape(y0.shape)
    return frame.field(python(t, y, *rest), y).reshape(-1)
hosts = ("rtol", "atol", "first_step", "max_step")
s = scipy.integrate.solve_ivp(
    slope, span, y0.reshape(-1), cg.scipy.Solver(frame, options.get("method", "auto")),
    t_eval=TIMES, dense_output=True, args=REST, **{k: options[k] for k in hosts if k in options})
assert s.success, s.message
y = [*s.y.T, *s.sol(s.t).T]"""
