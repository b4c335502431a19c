"""What lies on the disk.

run_directory.py  what a sweep writes, and reads again; lock.py one sweep per directory
layout.py         names of the parts of a run directory, none of which leads elsewhere
sweep_config.py   its config.json; config_file.py what that says of runs, as untrusted input
metrics.py        rows of metrics: dicts in memory, lines of JSON in files
checkpoints.py    checkpoints as files: finished, whole, and the config they carry
formats.py        older formats of config.json
policies.py       trained policies as plain arrays
looking.py        what lies at a path that the user names
untrusted.py      JSON from anybody: how deep, and what reading it raises
arrays.py         files of named arrays, read as untrusted input
provenance.py     what results depend on besides the settings
files.py          files that are whole or not there, and what the system refuses
"""
