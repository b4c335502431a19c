"""Questions of learning: does CGM help, which c_g and kappa, which masks?

train.py         trains the sweeps of a question, one after the other or several at a time
records.py       what is committed of a trained sweep, and how it is read back
tables.py        tables, from the rows of records
comparison.py    the paper's Fig. 4: success over training
calibration.py   how far estimates of success are off; a program of its own
"""
