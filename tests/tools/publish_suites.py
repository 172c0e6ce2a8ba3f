"""Publish suites: `python tests/tools/publish_suites.py [NAME…]` simulates their first scenes (a minute for all)
and writes `datagen/suites/NAME.json`.

What was published of a name stays. A suite whose rooms or light must change beyond their errors gets the next number.
"""

from __future__ import annotations

import sys

from datagen.suites.catalogue import SUITES
from datagen.suites.published import publish


def main() -> None:
    for name in sys.argv[1:] or SUITES:
        publish(SUITES[name].config).write(SUITES[name].path.with_suffix(".json"))
        print(name, flush=True)


if __name__ == "__main__":
    main()
