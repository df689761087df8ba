"""Diagnosis of methods: order, first violated condition, the coefficient that is wrong."""

from cg.construction.diagnosis.diagnosis import Diagnosis, diagnose, diagnose_file

__all__ = ["Diagnosis", "diagnose", "diagnose_file"]
