"""Run many `hnf` commands on many workers, keeping finished results and reporting failures.

`jobs` turns commands or a jobs file into jobs, `runner` plans them and gives them to dask workers, `attempt` runs one
on a worker, `staging` records and publishes results. Read `runner.run_batch` first. The Blender extension does not
contain this package.
"""
