"""The tasks of manip: one module per task, with its numbers in the docstring.

`<task>.py` defines the task. Its longer parts are beside it as `<task>_rewards.py` and
the like. `experts` holds the scripted policies, `scenes` the robosuite environments
that robosuite itself does not have.
"""
