"""JAX for tests: in double precision, and quick to compile; without it tests are skipped."""

import os

import pytest

# Compiling takes longer than what is tested.
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
)
jax = pytest.importorskip("jax", reason="jax isn't installed")
diffrax = pytest.importorskip("diffrax", reason="diffrax isn't installed")
jax.config.update("jax_enable_x64", True)
# Modules make no arrays of it when they are imported: what XLA starts then doesn't survive a fork.
