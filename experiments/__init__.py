"""The experiments: results, the programs that reproduce them, and the report (README.md).

The listing:

    run.py            trains, draws and tabulates the questions of plans.toml
    report.py         the tables and numbers of README.md, from records
    screens/          what README.md shows of questions once there is a record of them
    learning/         questions of learning
    physics/          questions of physics
    other_programs/   Stable-Baselines3 beside this program
    gpu/              what is to be known about a GPU
    results/          records of what was trained and measured; figures and tables made from them
    plans.toml        every sweep with all its settings, and every question with its sweeps
    pretrained.py     trains the policies that come with the package
    command_line.py   of programs that take nothing but paths
    table.py          CSV files; markdown.py the same for readers
"""
