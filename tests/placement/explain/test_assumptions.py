import pytest

from geometry.errors import InputError
from placement.explain.sensitivity import RANGES, load_assumptions, read_assumptions

GOOD = {"latency_s": {"values": [0.3, 0.0, 0.3], "source": "somewhere"}}


def test_every_assumption_is_varied_and_says_why():
    found = load_assumptions()
    assert {one.name for one in found} == set(RANGES)
    for one in found:
        assert one.reason
        assert list(one.values) == sorted(set(one.values))


def test_values_are_sorted_and_reasons_told_apart():
    (one,) = read_assumptions(GOOD, "mine.toml")
    assert (one.values, one.reason, one.is_ours) == ((0.0, 0.3), "somewhere", False)
    (other,) = read_assumptions({"yaw_deg": {"values": [1], "assumption": "so"}}, "mine.toml")
    assert other.is_ours


@pytest.mark.parametrize(
    ("document", "where"),
    [
        ({"colour": {}}, "mine.toml: colour"),
        ({"latency_s": 3}, "mine.toml: latency_s"),
        ({"latency_s": {"values": [0.1], "source": "a", "more": 1}}, "mine.toml: latency_s.more"),
        ({"latency_s": {"values": [], "source": "a"}}, "mine.toml: latency_s.values"),
        ({"latency_s": {"values": [0.1, -1.0], "source": "a"}}, "mine.toml: latency_s.values[1]"),
        ({"n_confirmations": {"values": [1.5], "source": "a"}}, "n_confirmations.values[0]"),
        ({"packet_loss": {"values": ["all"], "source": "a"}}, "packet_loss.values[0]"),
        ({"latency_s": {"values": [0.1]}}, "mine.toml: latency_s"),
        ({"latency_s": {"values": [0.1], "source": "a", "assumption": "b"}}, "latency_s"),
    ],
)
def test_what_cannot_be_is_refused_where_it_stands(document, where):
    with pytest.raises(InputError) as caught:
        read_assumptions(document, "mine.toml")
    assert where in caught.value.where
