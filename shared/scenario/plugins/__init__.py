"""What can be chosen by name, and a user's own things among it: which kinds there are, what a name is in a run, how it
is found. Never what a thing does: each room guards what it calls.
"""
