"""The radar's domain, and the messages between its processes."""

if __name__ != "cogradar.shared":  # a second copy of each module, and of all that it holds
    raise ImportError("in Python, this folder is cogradar.shared", name=__name__)
