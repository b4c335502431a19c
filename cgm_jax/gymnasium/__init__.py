"""What other libraries use, through Gymnasium's interface: nothing here imports JAX.

    registration.py         names of the Fetch tasks for `gymnasium.make`
"""
