"""Pictures by the workers of a Dask cluster; Dask does all scheduling, transport and retries."""
