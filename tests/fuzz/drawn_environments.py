"""Random uses of the environments as scripts: constructor, reset options, actions, also in the wrong order."""

import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

from hypothesis import strategies as st

from offtrack.environments.registry import CORES
from tests.fuzz.case import Case
from vehicle.combination.description import vehicle_names
from vehicle.rover.description import rover_names, soil_names

_HEAD: Final = "from math import inf, nan\nimport numpy as np\nimport offtrack.environments.registry as made\n"
_ODD: Final = st.sampled_from(
    (
        *("nan", "inf", "-1", "0", "1e308", "10**30", "None", "True", "4.0", "''", "'x'", "b'x'", "object()"),
        *("[]", "()", "(1,)", "(1, 2, 3)", "(2, 1)", "(nan, nan)", "{}", "{'a': 1}", "['none']", "np.zeros(3)"),
        *("'roundabout'", "('roundabout',)"),
    )
)
_KNOWN: Final = {
    "vehicle": [repr(name) for name in (*vehicle_names(), *rover_names())],
    "courses": ["('roundabout',)", "('random-1', 'turn-90')", "('random-3',)", "()", "'roundabout'", "('random-x',)"],
    "observation": ["'truth'", "'surrogate'", "'surrogate'", "'x'"],
    "soils": [repr((name,)) for name in soil_names()] + ["('none',)", "()"],
    "course": ["0", "1", "'roundabout'", "-1", "99", "True", "4.0"],
    "soil": [*map(repr, soil_names()), "'none'"],
    "reward": ["None", "{}", "{len: 1.0}", "{'x': 1.0}"],
    "image_scale": ["1", "2", "3", "0"],
    "action_repeat": ["1", "2", "5", "0", "1.5"],
    "render_mode": ["None", "'rgb_array'", "'x'"],
    "sensing": ["'roundabout'", "'rover-slope'", "'x'"],
}

_NUMBERS: Final = st.floats(-1.0, 1.0, width=32) | st.sampled_from([0.0, 1.0, -1.0])


def _options(name: str) -> dict[str, st.SearchStrategy[str]]:
    hints = get_type_hints(CORES[name][1])
    known = {key: _of(key, hints[key]) for key in CORES[name][1].model_fields}
    return {**known, "action_repeat": _of("action_repeat", int), "render_mode": _of("render_mode", str)}


def _of(name: str, annotation: Any) -> st.SearchStrategy[str]:
    if name in _KNOWN:
        return st.sampled_from(_KNOWN[name])
    if get_origin(annotation) is Literal:
        return st.sampled_from([repr(choice) for choice in get_args(annotation)])
    if get_origin(annotation) in (Union, types.UnionType):
        return st.one_of(*(_of(name, part) for part in get_args(annotation)))
    if is_dataclass(annotation) and isinstance(annotation, type):
        required = {field.name: _NUMBERS.map(repr) | _ODD for field in fields(annotation) if _is_required(field)}
        optional = {field.name: _range(field) for field in fields(annotation) if not _is_required(field)}
        given = st.fixed_dictionaries(required, optional=optional)
        path = f"__import__({annotation.__module__!r}, fromlist=['x']).{annotation.__name__}"
        return given.map(lambda values: f"{path}({', '.join(f'{key}={value}' for key, value in values.items())})")
    return _ODD


def _is_required(field: Any) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _range(field: Any) -> st.SearchStrategy[str]:
    if field.default is MISSING or not isinstance(field.default, tuple | int | float):
        return _ODD
    low, high = field.default if isinstance(field.default, tuple) else (0.0, 2.0 * field.default)
    value = st.floats(low, high)
    inside = st.tuples(value, value).map(lambda pair: repr((min(pair), max(pair))))
    return inside | inside | _ODD if isinstance(field.default, tuple) else value.map(repr) | _ODD


def _reset_options(name: str) -> dict[str, st.SearchStrategy[str]]:
    hints = get_type_hints(CORES[name][1])
    domain = hints.get("domain")
    ranges = {field.name: _range(field) for field in fields(domain)} if isinstance(domain, type) else {}
    return {**ranges, "course": _of("course", str), "soil": _of("soil", str), "unknown": _ODD, "reset_mask": _ODD}


_OPTIONS: Final = {name: _options(name) for name in CORES}
_RESETS: Final = {name: _reset_options(name) for name in CORES}
_ODD_ACTIONS: Final = ("nan", "inf", "-inf", "2.0", "1e38", "None", "'x'", "[]", "[[0.0]]", "{}", "1j", "True")
_LAST: Final = (
    *("env.close()", "env.close()\nenv.close()", "env.close()\nenv.step(action)", "env.close()\nenv.reset(seed=2)"),
    *(
        "env.render()",
        "import copy\ncopy.deepcopy(env).step(action)",
        "import pickle\npickle.loads(pickle.dumps(env)).step(action)",
    ),
)


@st.composite
def environment_uses(draw: st.DrawFn) -> Case:
    name = draw(st.sampled_from(sorted(CORES)))
    cameras = draw(st.integers(0, 59)) == 59
    odd = draw(st.integers(0, 2)) == 2
    options = draw(_some(_OPTIONS[name], 3 if odd else 1))
    many = draw(st.integers(0, 3)) == 3
    if cameras and name != "TractorTrailerDriving-v0":
        options |= {"observation": draw(st.sampled_from(["'estimate'", "'camera'"]))}
    elif "observation" in _OPTIONS[name]:
        options.setdefault("observation", "'truth'")
    if many:
        options["num_envs"] = draw(st.sampled_from(["1", "3", "8", "8"] + (["0", "-1", "1.5", "'x'"] if odd else [])))
        options["autoreset_mode"] = draw(st.sampled_from(["'NextStep'", "'SameStep'", "'Disabled'", "'x'"]))
        options.pop("render_mode", None)
    made = "vector" if many else "single"
    lines = [f"env = made.{made}({name!r}{''.join(f', {key}={value}' for key, value in options.items())})"]
    given = draw(_some(_RESETS[name], 2 if odd else 0))
    seed = draw(st.sampled_from(["1", "2", "None", "2**40"] + (["-1", "'x'", "1.5", "nan"] if odd else [])))
    options_text = ", ".join(f"{key!r}: {value}" for key, value in given.items())
    reset = f"seen, info = env.reset(seed={seed}, options={{{options_text}}})"
    lines += ["env.action_space.seed(1)", "action = env.action_space.sample()"]
    if not (odd and draw(st.integers(0, 4)) == 4):
        lines += [reset, "assert env.observation_space.contains(seen), seen"]
    lines += [line for _ in range(draw(st.integers(0, 4))) for line in draw(_steps(odd=odd))]
    if not many:
        lines += ["outcome = info.get('outcome', '')"] if "info" in "".join(lines) else []
    if draw(st.booleans()):
        lines.append(draw(st.sampled_from(_LAST)))
    return Case(kind=f"environment: {name}{', cameras' if cameras else ''}", script=_HEAD + "\n".join(lines) + "\n")


def _some(strategies: dict[str, st.SearchStrategy[str]], most: int) -> st.SearchStrategy[dict[str, str]]:
    names = st.lists(st.sampled_from(sorted(strategies)), max_size=most, unique=True)
    return names.flatmap(lambda chosen: st.fixed_dictionaries({key: strategies[key] for key in chosen}))


@st.composite
def _steps(draw: st.DrawFn, *, odd: bool) -> list[str]:
    step = "seen, reward, ended, cut, info = env.step(action)"
    checked = "assert env.observation_space.contains(seen), seen\nassert np.isfinite(reward).all(), reward"
    kind = draw(st.integers(0, 3 if odd else 1))
    if kind == 0:
        return [
            f"for _ in range({draw(st.sampled_from([1, 5, 60]))}):\n    action = env.action_space.sample()\n    {step}",
            checked,
        ]
    if kind == 1:
        return [f"action = np.full(env.action_space.shape, {draw(_NUMBERS)}, np.float32)", step, checked]
    value = draw(st.sampled_from(_ODD_ACTIONS))
    if kind == 2 and value in _ODD_ACTIONS[:5]:
        return [f"action = np.full(env.action_space.shape, {value})", step, checked]
    return [f"action = {value}", step, checked]
