"""What is to be known about a GPU: `make gpu`.

measure.py   which cases there are, each in a process of its own, resumed where it was stopped
cases.py     what one case measures: `python -m experiments.gpu.cases PART CASE`
parity.py    scripted episodes on one engine, for another process to compare with
"""
