r"""Jacobi elliptic functions, accurate for parameters m near 1.

Unlike ``scipy.special.ellipj`` they take the complementary modulus :math:`k' = \sqrt{1 - m}`, which
cancellation in :math:`1 - m` would make inaccurate near m = 1.
"""

from __future__ import annotations

import numpy as np
import scipy

from cg.frames.arrays import Array


def jacobi_functions(u: Array, complement: float) -> tuple[Array, Array, Array]:
    r"""Return sn, cn and dn of real arguments, to a few roundings of ``u``.

    Landen's descending transformation [1]_ reduces them to trigonometric functions.  Its common
    denominators follow from :math:`\mathrm{sn}^2 + \mathrm{cn}^2 = 1`, without cancellation.

    Parameters
    ----------
    u
        The arguments, any shape.
    complement
        The complementary modulus, from 0 to 1.

    References
    ----------
    .. [1] *NIST Digital Library of Mathematical Functions*, equations 22.7.2 and 22.7.3.
    """
    if complement == 0.0:
        decay = np.exp(-np.abs(u))
        secant = 2.0 * decay / (1.0 + decay * decay)
        return np.tanh(u), secant, secant
    moduli = []
    while 1.0 - complement > 1e-15:
        moduli.append(complement)
        u = u * (0.5 * (1.0 + complement))
        complement = 2.0 * np.sqrt(complement) / (1.0 + complement)
    sn, cn, dn = np.sin(u), np.cos(u), np.ones_like(u)
    for k in reversed(moduli):
        sn, cn = 2.0 * sn, (1.0 + k) * cn * dn
        length = np.hypot(sn, cn)
        sn, cn = sn / length, cn / length
        dn = np.hypot(cn, k * sn)
    return sn, cn, dn


def argument_of(sn: float, cn: float, complement: float) -> float:
    """Return the argument u, within a quarter period of zero, of given values of sn and cn.

    Parameters
    ----------
    sn, cn
        The values up to a common factor; ``cn`` isn't negative, and not both vanish.
    complement
        The complementary modulus, from 0 to 1, positive if ``cn`` is 0.
    """
    if complement == 0.0:
        return float(np.arcsinh(sn / cn))
    sn, cn = np.array([sn, cn]) / np.hypot(sn, cn)
    square = cn * cn
    return float(sn * scipy.special.elliprf(square, square + (complement * sn) ** 2, 1.0))
