"""The methods of the catalogue by kind."""

import cg


def of_kind(*kinds):
    return {name: method for name, method in cg.methods.items() if isinstance(method, kinds)}


FROZEN = of_kind(cg.Tableau, cg.CommutatorFree)
MUNTHE_KAAS = of_kind(cg.MuntheKaas)
MAGNUS = of_kind(cg.MagnusMethod)
SPLITTING = of_kind(cg.Splitting)
