"""Controllers: what `simulate` drives with. `check_controller` tells whether one keeps the contract.

`__init__.pyi` lists the public names. They are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
