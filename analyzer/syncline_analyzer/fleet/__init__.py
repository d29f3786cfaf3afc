"""Many captures of many machines, analyzed on a Dask cluster into one parquet data set."""
