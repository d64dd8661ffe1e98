"""The store of a study's pictures: each is computed once, and the one not used for the longest time is dropped."""

from cboxlab.validation.api.study import _RecentStore


def test_the_value_not_used_for_longest_is_computed_again():
    computed = []

    def value(key):
        return store.get(key, lambda: computed.append(key) or key)

    store = _RecentStore(2)
    assert [value(key) for key in "abacab"] == [*"abacab"]
    assert computed == [*"abcb"]
