"""A limit on how much may pass a second, with some in reserve for bursts."""


class TokenBucket:
    """Tokens that refill at a steady rate up to a capacity.

    Attributes:
        rate_per_s: Refill.
        capacity: Most that is kept.
    """

    def __init__(self, rate_per_s: float, capacity: float) -> None:
        self.rate_per_s = rate_per_s
        self.capacity = capacity
        self._tokens = capacity
        self._last_s: float | None = None

    def take(self, amount: float, now_s: float) -> bool:
        """Take an amount if it is there; an amount above the capacity needs a full bucket.

        Args:
            amount: Tokens.
            now_s: A clock that never goes back.
        """
        self._refill(now_s)
        if self._tokens < min(amount, self.capacity):
            return False
        self._tokens -= amount
        return True

    def available(self, now_s: float) -> float:
        """What could be taken now."""
        self._refill(now_s)
        return self._tokens

    def _refill(self, now_s: float) -> None:
        if self._last_s is not None:
            self._tokens = min(self.capacity, self._tokens + (now_s - self._last_s) * self.rate_per_s)
        self._last_s = now_s
