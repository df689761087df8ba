"""Methods: coefficients, tableaux, commutator-free, Munthe-Kaas and Magnus methods, stability."""
