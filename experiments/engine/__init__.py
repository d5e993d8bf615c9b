"""Where many tasks of one kind run: here, in processes of this machine, on a dask cluster."""
