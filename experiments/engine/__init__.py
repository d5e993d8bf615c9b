"""Where many tasks of one kind run.

Here, in processes of this machine, on a dask cluster.
"""
