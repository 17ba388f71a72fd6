"""Objects to grasp: ``object.yaml`` to ``GraspObject``, importing meshes, listing, pictures."""

from tacgen.objects.load import load_object

__all__ = ["load_object"]
