"""The real data that a study is given, checked before anything is collected."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from tacgen.collection.gel import contact_law
from tacgen.collection.perturbed import check_forces
from tacgen.collection.recipe import Contact, Recipe
from tacgen.core.errors import TacgenError
from tacgen.dataset.real_grasps import RealGrasps, read_real_grasps
from tacgen.learning.grasps import RealGraspImages
from tacgen.study.study_recipe import Study


@dataclass(frozen=True, slots=True)
class RealData:
    """Real grasps to test on, others to calibrate on, and a contact law.

    No grasp may be in both folders. ``contact`` is a ``contact.yaml`` of the real sensor.
    """

    test: Path | None = None
    calibration: Path | None = None
    contact: Path | None = None


def check_real_data(study: Study, real: RealData, *, quick: bool) -> None:
    """Check that the rows have what they need, and that what is given can be read.

    Raises ``TacgenError``, which lists everything that is wrong.
    """
    problems = []
    if any(row.calibrate_friction for row in study.rows) and real.calibration is None:
        fix = "real grasps that are not tested on; give them with --calibrate-on DIR"
        problems.append(f"{study.name}: a row calibrates friction, which needs {fix}")
    if any(row.calibrate_contact for row in study.rows) and real.contact is None:
        problems.append(
            f"{study.name}: a row uses the real sensor's contact law; give the contact.yaml that "
            "`tacgen calibrate contact` or `tacgen diagnose contact` wrote with --contact FILE"
        )
    law = Contact(file=str(real.contact) if real.contact is not None else None)
    checks = (
        partial(_check_tested, real),
        partial(_check_calibration, study, real.calibration, quick),
        partial(contact_law, law),
    )
    for check in checks:
        try:
            check()
        except TacgenError as error:
            problems.append(str(error))
    TacgenError.raise_if(problems)


def calibration_grasps(recipe: Recipe, folder: Path) -> RealGrasps:
    """The real grasps of the recipe's objects, to fit their friction to.

    Raises ``TacgenError`` if an object has none, or one asks for more force than the gripper has.
    """
    found = read_real_grasps(folder)
    wanted = {entry.object_name for entry in recipe.objects}
    missing = wanted - set(found.by_object())
    if missing:
        fix = "add some to calibrate their friction, or take the objects out of the study"
        msg = f"{folder}: has no grasps of {', '.join(sorted(missing))}; {fix}"
        raise TacgenError(msg)
    grasps = replace(found, grasps=tuple(g for g in found.grasps if g.config.object in wanted))
    check_forces(recipe, grasps)
    return grasps


def _check_tested(real: RealData) -> None:
    if real.test is None:
        return
    tested = set(RealGraspImages(real.test).table.ids.tolist())
    if real.calibration is None:
        return
    shared = tested & {grasp.grasp_id for grasp in read_real_grasps(real.calibration).grasps}
    if shared:
        fix = "calibrate on other grasps than those tested on"
        msg = f"{real.test} and {real.calibration} share grasps, such as {min(shared)}; {fix}"
        raise TacgenError(msg)


def _check_calibration(study: Study, folder: Path | None, quick: bool) -> None:
    if folder is None:
        return
    read_real_grasps(folder)
    for row in study.rows:
        if row.calibrate_friction:
            calibration_grasps(study.data_recipe(row, quick=quick), folder)
