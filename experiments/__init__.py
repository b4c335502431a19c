"""The experiments: results, the programs that reproduce them, and the report (README.md).

run.py       trains, draws and tabulates the questions of plans.toml
learning/    questions of learning
physics/     questions of physics
results/     records of what was trained and measured; figures and tables made from them
"""
