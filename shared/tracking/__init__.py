"""From the receiver's detections to the belief of one target: initiation, association, filters.

A track is a frozen state and pure functions of it. It ends at its belief: which bin to ask for is planning.
Never here: messages, processes, or what nature decides.
"""
