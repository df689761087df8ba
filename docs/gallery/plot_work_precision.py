"""
Work and precision of four methods
==================================

The error of four pairs at the end of the heavy top, for tolerances from 1e-3 to 1e-10, against the
number of evaluations.
"""

import matplotlib.pyplot as plt

import crouch_grossman as cg

top = cg.problems.HeavyTop()
exact = top.reference([2]).y[-1]
fig, ax = plt.subplots(figsize=(6, 4), layout="constrained")
for name in ("CG3(2)", "CF5(4)", "DP5(4)", "RKMK8(5,3)"):
    runs = [
        cg.solve_ivp(top.f, (0, 2), top.y0, frame=top.frame, method=name, rtol=tol, atol=tol)
        for tol in (10.0**-k for k in range(3, 11))
    ]
    errors = [float(top.frame.distance(run.y[-1], exact)) for run in runs]
    cg.plot.work_precision([run.nfev for run in runs], errors, ax, label=name)
plt.show()
