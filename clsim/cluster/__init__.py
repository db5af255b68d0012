"""Tasks on many processes: scheduling on this machine or on any Dask cluster."""
