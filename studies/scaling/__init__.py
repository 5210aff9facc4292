"""What it costs to be distributed: measured in runs, told in tables, extended to many targets by a model."""
