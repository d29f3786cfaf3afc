"""Speed of the product beside its peers, measured in one run: `uv run --group bench python -m benchmarks`."""
