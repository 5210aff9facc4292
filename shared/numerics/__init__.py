"""What every computation needs: random numbers keyed by their purpose, and compiled kernels.

Never here: anything that knows a radar.
"""
