"""Order conditions that follow from others, and the proofs that they do."""
