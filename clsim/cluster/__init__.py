"""Tasks on many processes: which worker does which when, on this machine or on any Dask cluster."""
