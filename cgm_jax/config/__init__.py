"""What is asked for. Imports no other room, and no JAX, so that bad input is refused at once.

settings.py  every setting: its default, its range, its help
presets.py   smoke, quick, cpu, paper
named.py     FILE.py:NAME; user_code.py runs it; allowed.py which files may run
grid.py      from lists of values to runs, and from runs to groups that train side by side
"""
