"""Certificates of conditions that are shown to be small, not zero."""

from dataclasses import replace

import pytest
from flint import arb

from cg.catalogue import methods
from cg.proofs import Certificate, CertificationError, certificate_of, certify, check
from cg.proofs.krawczyk import krawczyk
from cg.proofs.statement import Packed, free_of, system_of
from cg.proofs.zero import zero_of
from cg.support.balls import working_precision as precision

pytestmark = pytest.mark.no_core


class TestOnlySmall:
    """Certificates of methods whose dependent conditions are only shown to be small."""

    def test_dependent_conditions_are_below_a_bound(self):
        method = methods["CF5c"]
        certificate = certify(method, small=True)
        assert not certificate.complete
        assert certificate_of(method).complete
        assert "all but 8 of the independent conditions" in str(certificate)
        assert "those are below 1e-" in str(certificate)
        assert Certificate.loads(certificate.dumps()) == certificate
        check(certificate, method)
        heading, trees = certificate.identities[0].split(": ")
        assert len(trees.split()) == 8
        for wrong in ("1e-300", "1e-20", "0", "-1e-50", "small"):
            name = f"only small, below {wrong}: {trees}"
            with pytest.raises(CertificationError):
                check(replace(certificate, identities=(name,)), method)
        for wrong in (f"{heading}: {trees} []", f"{heading}: {trees} [[]", f"{heading}: "):
            with pytest.raises(CertificationError):
                check(replace(certificate, identities=(wrong,)), method)
        with pytest.raises(CertificationError):
            check(replace(certificate, identities=(*certificate.identities, "path: 0")), method)
        with pytest.raises(CertificationError, match="only shown to be small"):
            method.digits(40, certificate=certificate)

    def test_an_independent_condition_is_not_as_small(self):
        """Its residual is 1e-36, the rounding of coefficients, not that of a zero of the others."""
        method = methods["CG4a"]
        certificate = certify(method)
        free = [name for name in method.layout.names if name not in certificate.fixed]
        wrong = replace(
            certificate,
            identities=("only small, below 1e-41: [[[[[]]]]]",),
            fixed=(*certificate.fixed, free[0]),
        )
        with pytest.raises(CertificationError, match="that conditions are small is not proved"):
            check(wrong, method)

    def test_where_the_zero_is(self):
        """A wide image of the map is computed again, and still contains the zero."""
        method = methods["CG4a"]
        certificate = replace(certify(method), radius="1e-12")
        packed = Packed.of(method)
        with precision(certificate.bits):
            system, free = system_of(packed, certificate), free_of(packed, certificate)
            wide = krawczyk(system, packed.balls(), free, arb("1e-12"))
            actual = zero_of(packed, certificate, wide)
            assert wide.proved
            assert max(float(ball.rad()) for ball in wide.image) > 1e-30
            assert max(float(actual[k].rad()) for k in free) < 1e-45
            assert all(wide.image[i].contains(actual[k]) for i, k in enumerate(free))
            assert all(abs(value) < 1e-40 for value in system.residuals(actual))

    def test_not_needed_where_all_are_independent(self):
        assert certify("CG3", small=True).complete
        with pytest.raises(TypeError, match="small"):
            certify("CG3", small=1)
