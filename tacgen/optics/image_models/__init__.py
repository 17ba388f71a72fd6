"""What renders a gel's slopes: one module an image model, one registry.

Every module of this folder is imported, and those of models register themselves.
"""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.optics.image_models.base import ImageModel as ImageModel
from tacgen.optics.image_models.base import Shade as Shade
from tacgen.optics.image_models.base import TableSection as TableSection
from tacgen.optics.image_models.base import features as features
from tacgen.optics.image_models.base import load_model as load_model
from tacgen.optics.image_models.base import nearest_quadratic as nearest_quadratic
from tacgen.optics.image_models.base import register_model as register_model
from tacgen.optics.image_models.quadratic import Quadratic as Quadratic
from tacgen.optics.image_models.response import ContactLight as ContactLight
from tacgen.optics.image_models.response import Response as Response

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
