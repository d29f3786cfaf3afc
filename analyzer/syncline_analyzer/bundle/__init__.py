"""Evidence bundles: one file for the supplier, with everything that a case needs."""
