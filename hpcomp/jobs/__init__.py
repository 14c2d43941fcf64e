"""Many stacks: jobs as tables and files, what runs them where, and what is remembered of them.

schema     what a job is, and what it may hold
jobfile    jobs read from TOML, JSON, JSON Lines and CSV, and written
frames     the jobs of a numbered sequence
state      what earlier runs have made, and from what
maker      what decides over their bytes: the versions of hpcomp and of its libraries
doing      one job, in a process of its own
processes  such processes, on this machine
cluster    such processes, on the machines of a Dask cluster: jobs given, results taken
worker     what is done on these machines
batch      which job is begun when, and what became of each
"""
