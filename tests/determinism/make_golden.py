"""Writes golden_hashes.json anew: python tests/determinism/make_golden.py

Only after a change that is meant to change results. The hashes are those of the CPU; every other device must agree.
"""

import json

import golden

if __name__ == "__main__":
    found = {name: golden.hashes(name, device="cpu") for name in golden.SCENES}
    golden.PATH.write_text(json.dumps(found, indent=2) + "\n")
    print(golden.PATH.read_text(), end="")
