"""The command about stores."""
