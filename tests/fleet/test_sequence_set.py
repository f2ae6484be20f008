from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mulan.fleet.sequence_set import SequenceSet


@given(st.lists(st.one_of(st.integers(1, 40), st.integers(-40, -1)), max_size=80))
def test_behaves_like_a_set_of_numbers(steps: list[int]) -> None:
    """A positive step adds a number, a negative one settles everything below it."""
    ours, plain = SequenceSet(), set[int]()
    for step in steps:
        if step > 0:
            ours.add(step)
            plain.add(step)
        else:
            ours.settle_below(-step)
            plain |= set(range(1, -step))
    assert [n for n in range(1, 45) if n in ours] == sorted(plain)
    ranges = [(1, ours.through)] * bool(ours.through) + ours.beyond
    assert [n for first, last in ranges for n in range(first, last + 1)] == sorted(plain)
    assert all(b[0] > a[1] + 1 for a, b in pairwise(ranges))
    assert not ours.beyond or ours.beyond[0][0] > ours.through + 1
