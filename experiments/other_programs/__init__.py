"""Against what people use: Stable-Baselines3 on the Fetch tasks of Gymnasium-Robotics.

compare.py            trains all arms, each run on a core of its own: `make compare-sb3`
arms.py               who learns, on what, and with which settings
sb3_run.py            one run of Stable-Baselines3; its requirements are sb3-requirements.txt
our_run.py            one run of this program
runs.py               which runs are on record, and where
curve.py              what every run writes: success by environment steps and CPU seconds
figure.py             the figure, from those; report_tables.py the table of the report
"""
