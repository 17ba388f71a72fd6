"""What a linear contact law can lack: one module an effect, one registry.

Every module of this folder is imported, and those of effects register themselves.
"""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.contact.effects.base import CHANNELS as CHANNELS
from tacgen.contact.effects.base import STAGES as STAGES
from tacgen.contact.effects.base import Channel as Channel
from tacgen.contact.effects.base import Effect as Effect
from tacgen.contact.effects.base import LoadHistory as LoadHistory
from tacgen.contact.effects.base import Variant as Variant
from tacgen.contact.effects.base import Where as Where
from tacgen.contact.effects.base import all_effects as all_effects
from tacgen.contact.effects.base import find_effect as find_effect
from tacgen.contact.effects.base import register as register
from tacgen.contact.effects.base import separating_measurement as separating_measurement

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
