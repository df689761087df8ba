"""Programs that made the catalogue, and proofs that methods don't exist; not installed."""
