"""A long stored run, made up: to play 20 000 dwells of the paper's scenario takes minutes."""

from pathlib import Path
from typing import Any

import numpy as np

from cogradar.services.recorder.journal import Journal
from cogradar.shared.protocol.messages import Message, Plan, RunStart, Scan, Truth, Waveform
from cogradar.shared.protocol.topics import BY_MESSAGE
from cogradar.shared.scenario.files import load
from cogradar.shared.scenario.radar_config import Strategy
from cogradar.shared.signal.array import angle_bin, spatial_frequency
from cogradar.shared.wire.codec import encode
from tests.samples import asked
from tests.services.stored import seal


def long_run(path: Path, dwells: int) -> Path:
    """A store with a finished run whose tracks never move; its messages are as long as those of the paper's."""
    journal, paper, acquisition = Journal(str(path)), load("paper"), 10
    start, radar = RunStart.of(paper, Strategy.POWER_AWARE, 1, dwells).model_copy(update={"run": "long"}), paper.radar
    states, tracks = paper.simulated.initial_states(), range(radar.announced)
    journal.add_run(start)
    bins = angle_bin(spatial_frequency(states), radar.array.n_bin).astype(np.int32)
    for k in range(dwells + acquisition):
        t = max(0, k - acquisition + 1)
        cells = bins if t else np.arange(radar.array.n_bin, dtype=np.int32)
        order, n, is_tracking = np.sort(cells), len(cells), k >= acquisition - 1
        head: dict[str, Any] = {"run": "long", "k": k}
        beams = (bins if is_tracking else np.full_like(bins, -1))[:, np.newaxis]
        said: list[Message] = [
            Scan(
                **head,
                t=t,
                bins=order,
                statistic=np.full(n, 40.0),
                alpha_hat=np.ones(n, dtype=np.complex64),
                sigma_hat=np.ones(n),
                signature_power=np.full(n, 100.0),
                beams=(bins if t else np.full_like(bins, -1))[:, np.newaxis],
            ),
            Truth(
                **head,
                t=t,
                states=states,
                heights_km=np.zeros(len(bins)),
                bins=bins,
                snr_db=np.full(len(bins), -14.0),
                waveform_k=k - 1,
            ),
            Waveform(
                **head,
                tracking=is_tracking,
                isotropic=0.0,
                factor=np.ones((radar.array.n_tx, len(bins)), dtype=np.complex64),
                beams=beams,
                shares=np.where(beams >= 0, 0.3, 0.0),
                status="optimal" if is_tracking else "acquisition",
                late=np.zeros_like(bins),
            ),
        ]
        for m in tracks:
            status: Any = "tracking" if is_tracking else "searching"
            wanted = asked(int(bins[m])) if is_tracking else {}
            said.append(Plan(**head, t=t, target=m, status=status, **wanted, estimate=states[m] + 0.1))
        for message in said:
            item = message.target + 1 if isinstance(message, Plan) else 0
            journal.add_message("long", k, BY_MESSAGE[type(message)].name, item, encode(message))
    journal.acknowledge("long", dwells + acquisition, dwells, 0)
    journal.write("UPDATE run SET status = 'complete', digest = '0'")
    seal(journal)
    journal.close()
    return path
