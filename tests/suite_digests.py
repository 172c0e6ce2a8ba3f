"""The digests of all suites as published: `datagen/suites/digests.json`.

    python tests/suite_digests.py FOLDER

builds the suites that are not in FOLDER yet (a quarter of an hour on two cores) and pins what they give. A suite that
was published never changes: one that must gets a new version, a configuration of another name beside the old one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from datagen.building.build import build
from datagen.store.environment import LIBRARIES, made_with
from datagen.store.verify import dataset_digest
from datagen.suites.catalogue import PINNED, SUITES


def main() -> None:
    old = json.loads(PINNED.read_text())["digests"] if PINNED.exists() else {}
    digests = {}
    for name, suite in SUITES.items():
        path = Path(sys.argv[1], f"{name}.zarr")
        build(suite.config, path, 2)
        digests[name] = dataset_digest(path)
        print(name, "as before" if old.get(name) == digests[name] else "changed", flush=True)
    made = {name: made_with()[name] for name in (*LIBRARIES, "machine")}
    PINNED.write_text(json.dumps({"made_with": made, "digests": digests}, indent=1) + "\n")


if __name__ == "__main__":
    main()
