r"""Jacobi's elliptic functions, accurate for parameters that are 1 or next to it.

All functions here take the complementary modulus :math:`k' = \sqrt{1 - m}`: near m = 1 the
parameter itself has none of its digits.
"""

from __future__ import annotations

import numpy as np
import scipy

from cg.frames.arrays import Array


def jacobi_functions(u: Array, complement: float) -> tuple[Array, Array, Array]:
    r"""Return sn, cn and dn of real arguments, right to a few roundings of ``u``.

    Landen's descending transformation [1]_ leads to trigonometric functions.  Its common
    denominators follow from :math:`\mathrm{sn}^2 + \mathrm{cn}^2 = 1`, and nothing cancels.

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
    """Return the u within a quarter period of zero at which sn and cn have given values.

    Parameters
    ----------
    sn, cn
        Up to a common factor; ``cn`` isn't negative, and both don't vanish.
    complement
        The complementary modulus, from 0 to 1, and not 0 where ``cn`` is.
    """
    if complement == 0.0:
        return float(np.arcsinh(sn / cn))
    sn, cn = np.array([sn, cn]) / np.hypot(sn, cn)
    square = cn * cn
    return float(sn * scipy.special.elliprf(square, square + (complement * sn) ** 2, 1.0))
