"""What a front end of your own is made of; docs/howto/front-end.md shows one."""

from cogradar.services.emulator.front_end import (
    FrontEnd,
    FrontEndError,
    ScanData,
    SenselessScan,
    Settings,
    Transmission,
    calibrate,
    receive,
)
from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.detector.calibration import Antennas, Calibration
from cogradar.shared.signal.detector.data_set import DataSet, Processing
from cogradar.shared.signal.detector.noise_faults import Finding, NoiseLevels
from cogradar.shared.signal.looks import Look, Measured, range_cell_centre, reported
from cogradar.shared.signal.receiver import Cell, wald_test
from cogradar.shared.signal.waveform import Signatures, root, transmit_signatures

__all__ = [
    "Antennas",
    "Calibration",
    "Cell",
    "DataSet",
    "Finding",
    "FrontEnd",
    "FrontEndError",
    "Look",
    "Measured",
    "NoiseLevels",
    "Processing",
    "ScanData",
    "SenselessScan",
    "Settings",
    "Signatures",
    "Transmission",
    "bin_centres",
    "calibrate",
    "range_cell_centre",
    "receive",
    "reported",
    "root",
    "steering_vector",
    "transmit_signatures",
    "wald_test",
]
