"""datagen: the dataset factory for machine learning on non-line-of-sight single-photon data.

Each public name is imported when it is first used, so that `import datagen` and `datagen --help` stay quick. The list
of the names is `__init__.pyi`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
