"""The processes: one module per role, the command line, and the page that says who runs."""

import shared  # noqa: F401 - fixes the linear-algebra thread count before NumPy is imported
