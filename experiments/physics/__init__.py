"""Questions of physics: are these the Fetch tasks that people know?

    fidelity.py                replays episodes recorded from Gymnasium-Robotics
    timestep.py                which timestep is close to the recording, and how fast it is
    scripted.py                controllers written by hand, which solve the tasks
    transfer.py                plays trained policies in Gymnasium-Robotics and here
    gymnasium_policy.py        its half that runs where gymnasium-robotics is installed
    gymnasium_sensitivity.py   how far Gymnasium-Robotics strays from itself (runs there too)

Each but scripted.py is a program: `python -m experiments.physics.NAME`.
"""
