"""How fast it is: what `python -m cgm_jax.benchmark` measures.

Against what the machine can do:

    start.py        from the command to the first training cycle
    rollouts.py     environment steps through the scan against raw MuJoCo
    updates.py      network updates against a matrix product
    sweeps.py       runs side by side against runs alone
    workload.py     the runs that are measured; figures.py a figure and its target
"""
