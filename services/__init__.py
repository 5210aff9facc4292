"""The processes: a folder per role, what roles share, and what people run from outside."""

if __name__ != "cogradar.services":  # a second copy of each module, and of all that it holds
    raise ImportError("in Python, this folder is cogradar.services", name=__name__)
