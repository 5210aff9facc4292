"""How long the certificate of this process is valid: in the log while its end is near, and always in the metrics."""

import logging
import math
import time
from collections.abc import Callable

from cogradar.services.certs.own import shown
from cogradar.shared.wire.meter import Measures

SOON_DAYS = 30.0
DAY_S = 86_400.0
log = logging.getLogger(__name__)


class Validity:
    """Of the certificate that a process shows, if it shows one."""

    def __init__(self, certificate: bytes | None, now_s: Callable[[], float] = time.time) -> None:
        """`certificate` is PEM; `now_s` is the time since 1970. Raises BadInput if it is no certificate."""
        self._now_s, self._end_s, self._name, self._told_s = now_s, math.inf, "", -math.inf
        if certificate is not None:
            from cogradar.services.certs import authority

            self._end_s, self._name = authority.end_of(certificate), authority.name_on(certificate)

    @classmethod
    def at(cls, endpoints: str, side: str = "connect") -> "Validity":
        """Of the certificate that is shown at these endpoints. Raises BadInput."""
        return cls(shown(endpoints, side))

    @property
    def days(self) -> float:
        """That are left; negative if it has ended, infinite without a certificate."""
        return (self._end_s - self._now_s()) / DAY_S

    def measures(self) -> Measures:
        """The days, of a process that has a certificate."""
        return {} if math.isinf(self._end_s) else {"certificate_days": self.days}

    def tell(self) -> None:
        """Say in the log that its end is near, once a day. To be called now and then, from the start on."""
        if self.days < SOON_DAYS and self._now_s() >= self._told_s + DAY_S:
            self._told_s = self._now_s()
            what = f"ends in {self.days:.1f} days" if self.days > 0.0 else f"ended {-self.days:.1f} days ago"
            whose = f" of {self._name}" if self._name else ""
            log.warning("the certificate%s %s: issue another one and start again (docs/howto/secure.md)", whose, what)
