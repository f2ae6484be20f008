"""Which sequence numbers have been settled: one run from the start, and what lies beyond gaps."""

from bisect import bisect_right


class SequenceSet:
    """Numbers from 1 on, kept as disjoint ranges.

    Attributes:
        through: Every number up to this one is in the set.
        beyond: Ranges (first, last) after the first gap, in order.
    """

    def __init__(self, through: int = 0) -> None:
        self.through = through
        self.beyond: list[tuple[int, int]] = []

    def __contains__(self, number: int) -> bool:
        if number <= self.through:
            return True
        at = bisect_right(self.beyond, (number, 2**63))
        return at > 0 and self.beyond[at - 1][1] >= number

    def add(self, number: int) -> None:
        """Put one number in."""
        if number in self:
            return
        at = bisect_right(self.beyond, (number, 2**63))
        first = last = number
        if at < len(self.beyond) and self.beyond[at][0] == number + 1:
            last = self.beyond.pop(at)[1]
        if at > 0 and self.beyond[at - 1][1] == number - 1:
            first = self.beyond.pop(at - 1)[0]
            at -= 1
        if first == self.through + 1:
            self.through = last
        else:
            self.beyond.insert(at, (first, last))

    def settle_below(self, number: int) -> None:
        """Put in every number below one."""
        if number - 1 <= self.through:
            return
        self.through = number - 1
        while self.beyond and self.beyond[0][0] <= self.through + 1:
            self.through = max(self.through, self.beyond.pop(0)[1])
