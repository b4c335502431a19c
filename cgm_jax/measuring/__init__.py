"""How fast it is: what `python -m cgm_jax.benchmark` measures.

Against what the machine can do:

    start.py        from the command to the first training cycle
    rollouts.py     environment steps through the scan against raw MuJoCo
    engines.py      environment steps of any engine on any device
    updates.py      network updates against a matrix product
    sweeps.py       runs of a sweep against runs alone
    workload.py     the runs that are measured; figures.py a figure and its target
    child.py        a program in a process of its own, whose output is a measurement
    compilations.py how many programs were compiled

Against another commit:

    comparison.py   rounds of one process for each side, and what comes out of them
    checkouts.py    this checkout and a worktree of the other commit
    training_process.py   a sweep that runs one epoch at a time, and what each takes
    ratios.py       a ratio from pairs, with its confidence interval
    unwinding.py    removes what was made, also when a signal ends the program
"""
