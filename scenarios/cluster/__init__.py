"""Studies on a Dask cluster (extra ``cluster``)."""
