"""Power of each transmit antenna and its peak over the mean, from the waveforms that are stored."""

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from cogradar.services.metrics.queries import messages, pieces, stored
from cogradar.services.metrics.store import Store

MOST = 256  # waveforms of an answer: 0.5 ms each with 100 antennas


class AntennaPowers(NamedTuple):
    """Of n waveforms of a run."""

    ts: NDArray[np.int64]  # (n,) dwells that radiated them
    powers: NDArray[np.float64]  # (n, n_tx)
    papr_db: NDArray[np.float64]  # (n, n_tx) peak over mean power (`signal.waveform.peak_to_average_db`)

    @classmethod
    def of(cls, store: Store, run: str, first: int | None, last: int | None, most: int = MOST) -> Self:
        """Of those in the dwells first .. last that are stored, `most` at equal steps if there are more."""
        from cogradar.shared.signal.waveform import antenna_powers, peak_to_average_db

        dwells = store.scored(
            "SELECT t, waveform_k AS k FROM picture WHERE run = ? AND t BETWEEN ? AND ? ORDER BY t",
            [run, first or 0, 2**31 if last is None else last],
        )
        there = {row["k"] for row in stored(store, run, "waveform", [row["k"] for row in dwells], 0, "k")}
        found = [row for row in dwells if row["k"] in there]
        found = found[:: -(-len(found) // most)] if found else []
        powers, papr_db = list[NDArray[np.float64]](), list[NDArray[np.float64]]()
        for some in pieces(found):
            stored_here = messages(store, run, "waveform", [row["k"] for row in some])
            for one in (stored_here[row["k"]] for row in some):  # a stale one was radiated again
                sent = one["isotropic"], one["factor"].astype(np.complex128)
                powers.append(antenna_powers(*sent))
                papr_db.append(peak_to_average_db(*sent))
        return cls(np.array([row["t"] for row in found], np.int64), np.array(powers), np.array(papr_db))

    def rows(self) -> list[dict[str, Any]]:
        """A row per antenna: means and largest values over the waveforms."""
        if not self.ts.size:
            return []
        names = ("power", "power_max", "papr_db", "papr_max_db")
        columns = [of(axis=0) for values in self[1:] for of in (values.mean, values.max)]
        of_all = {"first_dwell": int(self.ts[0]), "last_dwell": int(self.ts[-1]), "n": self.ts.size}
        return [
            of_all | {"antenna": i + 1} | dict(zip(names, values, strict=True))
            for i, values in enumerate(zip(*(column.tolist() for column in columns), strict=True))
        ]
