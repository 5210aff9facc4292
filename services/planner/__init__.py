"""The planner role: beliefs of the tracks that this worker owns, and a plan for each after every scan.

It composes tracking and planning, which do not know each other, and converts messages to what they understand.
Never here: another role, or the truth.
"""
