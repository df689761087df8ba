"""Methods: coefficients, tableaux, commutator-free and Munthe-Kaas methods, stability."""
