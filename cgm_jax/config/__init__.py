"""What is asked for: settings, presets and grids.

fields.py      how a setting is declared and checked; common.py what several kinds declare
settings.py    the loop's own settings; sizes.py what components may know of them
components.py  curricula, agents and ways to relabel by name
named.py       from the user's own files; user_code.py runs them, allowed.py which ones may run
presets.py     smoke, quick, cpu, gpu, paper
spelling.py    values as words, as options have them, and back
run_names.py   names of runs: what tells them apart
missing.py     NaN and null: numbers that do not exist yet
grid.py        from lists of values to runs, and from runs to groups that train side by side;
               shards.py parts of it, for as many processes and machines
"""
