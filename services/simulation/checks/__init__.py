"""What must hold of a schedule: in lockstep the same run, in real time what a radar promises."""
