"""find_contacts against the oracle: no contact is missed, none is invented, whatever the cloud, the type, the form."""

import fastcollide as fc
import numpy as np
import pytest
from reference.all_pairs import GOLDEN_SETS, golden_cloud, pair_hash


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", GOLDEN_SETS)
def test_golden_sets(name, dtype):
    position, radius = golden_cloud(name)
    _, pairs, golden_hash = GOLDEN_SETS[name]

    found = fc.find_contacts(position.astype(dtype), radius.astype(dtype))

    assert (len(found), pair_hash(found.first, found.second)) == (pairs, golden_hash)
