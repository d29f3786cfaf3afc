"""The analyses: folds over indexed batches."""
