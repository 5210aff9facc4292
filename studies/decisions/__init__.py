"""What decisions are worth: policies and agents beside each other, bounds on any search, accuracy that is asked for."""
