"""Settings of the smoke scenario under which plans, waveforms and scans carry lists of cells."""

WEAK = "radar.echo.amplitude_db=57"  # too little power for two looks in every dwell
TURNING = (  # close to a small array; off its bins in a few dwells
    "world.targets.1.state=[8.0,0.0,-4.0,0.28]",
    "world.targets.1.turns=[{from_s=8.0,to_s=16.0,g=-9.0},{from_s=24.0,to_s=32.0,g=9.0}]",
)
SETTINGS = {
    "joint": ("radar.planner.looks=joint",),
    "paper, joint": ("radar.planner.looks=joint", "radar.fidelity=paper"),
    "wide, joint": ("radar.planner.looks=joint", *TURNING),
    "urgency, joint": ("radar.planner.looks=joint", "radar.allocation.objective=urgency", WEAK),
    "best": ("radar.fidelity=best",),
    "best-range": ("radar.fidelity=best-range",),
}
