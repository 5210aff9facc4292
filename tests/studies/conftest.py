"""Services that are up, as the tests of services have them."""

from tests.services.conftest import endpoint

__all__ = ["endpoint"]
