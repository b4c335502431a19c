"""Questions of physics: are these the Fetch tasks that people know?

Programs, each `python -m experiments.physics.NAME`:

    fidelity.py                replays episodes recorded from Gymnasium-Robotics
    timestep.py                which timestep is close to the recording, and how fast it is
    start.py                   what the start takes on each engine
    doing_nothing.py           how often goals are achieved by doing nothing
    transfer.py                plays trained policies in Gymnasium-Robotics and here
    gymnasium_policy.py        its half that runs where gymnasium-robotics is installed
    hosted_speed.py            how fast Gymnasium's environments are as tasks
    hosted_alone.py            its half that has such an environment alone
    gymnasium_sensitivity.py   how far Gymnasium-Robotics strays from itself (runs there too)

What they share:

    scripted.py                controllers written by hand, which solve the tasks
    report_tables.py           tables of the report, from what the programs wrote
"""
