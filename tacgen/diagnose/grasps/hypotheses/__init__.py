"""What may be wrong with a simulated grasp: the hypotheses and their registry."""

from importlib import import_module
from pkgutil import iter_modules

from tacgen.diagnose.grasps.hypotheses.registry import Hypothesis as Hypothesis
from tacgen.diagnose.grasps.hypotheses.registry import HypothesisCandidate as HypothesisCandidate
from tacgen.diagnose.grasps.hypotheses.registry import HypothesisParameter as HypothesisParameter
from tacgen.diagnose.grasps.hypotheses.registry import Prediction as Prediction
from tacgen.diagnose.grasps.hypotheses.registry import advice as advice
from tacgen.diagnose.grasps.hypotheses.registry import candidates_for as candidates_for
from tacgen.diagnose.grasps.hypotheses.registry import register as register
from tacgen.diagnose.grasps.hypotheses.registry import registered as registered

for _module in iter_modules(__path__):
    import_module(f"{__name__}.{_module.name}")
