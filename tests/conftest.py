"""What all tests share. `shared` is imported before NumPy: it sets the number of linear-algebra threads."""

import shared  # noqa: F401, I001
from hypothesis import settings

# The first example of a property may compile a kernel.
settings.register_profile("cogradar", deadline=None)
settings.load_profile("cogradar")
