"""The processes: a folder per role, what roles share, and what people run from outside."""

import shared  # noqa: F401 - fixes the linear-algebra thread count before NumPy is imported
