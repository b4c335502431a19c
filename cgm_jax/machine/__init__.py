"""What this process runs on, which any folder may ask; only Python's own library comes with it.

allotment.py      cores and memory: a container, a batch system or an affinity mask may limit them
device_errors.py  errors from below JAX, in one line
forking.py        whether it was forked off a process in which JAX ran; loaded with the package
commands.py       commands to be typed as they are printed
"""
