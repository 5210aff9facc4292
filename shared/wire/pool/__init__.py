"""Processes of one role that share the runs: which one serves which shard. What is decided is pure (`shares`); what is
seen and shown are liveliness tokens (`members`). Nothing here knows a role, or what a run is.
"""
