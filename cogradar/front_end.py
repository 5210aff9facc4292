"""What a front end of your own is made of; docs/howto/front-end.md shows one."""

from cogradar.services.emulator.front_end import FrontEnd, FrontEndError, ScanData, Settings, Transmission
from cogradar.shared.signal.array import bin_centres, steering_vector
from cogradar.shared.signal.looks import Look, Measured, measure, range_cell_centre, reported
from cogradar.shared.signal.receiver import Cell, wald_test
from cogradar.shared.signal.waveform import Signatures, root, transmit_signatures

__all__ = [
    "Cell",
    "FrontEnd",
    "FrontEndError",
    "Look",
    "Measured",
    "ScanData",
    "Settings",
    "Signatures",
    "Transmission",
    "bin_centres",
    "measure",
    "range_cell_centre",
    "reported",
    "root",
    "steering_vector",
    "transmit_signatures",
    "wald_test",
]
