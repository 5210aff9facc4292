"""Between simulated processes: the way of each message, and what the processes of a pool see of each other."""
