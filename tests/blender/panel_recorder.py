"""A layout that draws nothing: it checks every call against Blender's own description of UILayout, and keeps the
words. Panels cannot be drawn without a window; what they ask for can be looked at without one."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import bpy

from hnf_lab.blender_bench.scenes import make_tab_context

FUNCTIONS = {function.identifier: function for function in bpy.types.UILayout.bl_rna.functions}
ICONS = {item.identifier for item in FUNCTIONS["label"].parameters["icon"].enum_items}
SETTINGS = {prop.identifier for prop in bpy.types.UILayout.bl_rna.properties}


class Given:
    """Properties of an operator button; knows no others than the operator's own."""

    def __init__(self, idname: str, owner: Recorder) -> None:
        object.__setattr__(self, "_known", rna_of(idname).properties)
        object.__setattr__(self, "_to", (idname, owner))

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in self._known, f"{self._to[0]} has no property {name}"
        prop = self._known[name]
        if prop.type == "ENUM" and prop.enum_items:
            assert value in {item.identifier for item in prop.enum_items}, f"{self._to[0]}.{name} = {value!r}"
        self._to[1].given.append((self._to[0], name, value))


def rna_of(idname: str) -> Any:
    """Blender's description of an operator; KeyError-like failure where there is none."""
    module, name = idname.split(".")
    return getattr(getattr(bpy.ops, module), name).get_rna_type()


@dataclass
class Recorder:
    """One layout and all made from it: texts, operators (idnames), props (names), given (operator properties)."""

    texts: list[tuple[str, bool]] = field(default_factory=list)
    operators: list[str] = field(default_factory=list)
    props: list[str] = field(default_factory=list)
    given: list[tuple[str, str, Any]] = field(default_factory=list)
    icons: list[str] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        assert name in FUNCTIONS, f"UILayout has no {name}"
        return lambda *values, **named: self._call(name, values, named)

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in self.__dataclass_fields__:
            assert name in SETTINGS, f"UILayout has no {name}"
            return
        object.__setattr__(self, name, value)

    def _call(self, name: str, values: tuple[Any, ...], named: dict[str, Any]) -> Any:
        parameters = [p.identifier for p in FUNCTIONS[name].parameters if not p.is_output]
        named = dict(zip(parameters, values, strict=False)) | named
        for key, value in named.items():
            assert key in parameters, f"UILayout.{name} takes no {key}"
            if key == "icon":
                assert value in ICONS, f"no icon {value}"
                self.icons.append(value)
            if key == "text":
                assert isinstance(value, str)
                self.texts.append((value, named.get("translate", True)))
        if name == "prop":
            assert named["property"] in named["data"].bl_rna.properties, named["property"]
            self.props.append(named["property"])
        if name == "operator":
            self.operators.append(named["operator"])
            return Given(named["operator"], self)
        if name in {"menu", "popover"}:
            wanted = named.get("menu") or named.get("panel")
            assert hasattr(bpy.types, wanted), f"no menu {wanted}"
        if name == "template_list":
            assert hasattr(bpy.types, named["listtype_name"]), named["listtype_name"]
        return self

    @property
    def words(self) -> str:
        """Everything that stands there, a line a label."""
        return "\n".join(text for text, _ in self.texts)


ROW_PX, GAP_PX, HEADER_PX, LIST_FRAME_PX = 20.0, 5.0, 31.0, 22.0
"""Height of a row of the interface, of the gap between rows that are not joined, of a panel's header with its frame,
and of a list around its rows, at resolution scale 1 [px]; measured on a screenshot of Blender 5.2."""


class Sized:
    """A layout that only measures: rows, height [px] and words of what is put into it."""

    def __init__(self, *, is_row: bool = False) -> None:
        self.__dict__.update(is_row=is_row, scale_y=1.0, parts=[], own_words=[])

    def __getattr__(self, name: str) -> Any:
        assert name in FUNCTIONS, f"UILayout has no {name}"
        return lambda *values, **named: self._add(name, values, named)

    def _add(self, name: str, values: tuple[Any, ...], named: dict[str, Any]) -> Any:
        if name in {"row", "split", "column", "box"}:
            part = Sized(is_row=name in {"row", "split"})
            self.parts.append(part)
            return part
        rows, height = 1, ROW_PX
        if name == "template_list":
            rows = named["rows"]
            height = rows * ROW_PX + LIST_FRAME_PX
        elif name == "template_icon":
            height = named["scale"] * ROW_PX
        elif name == "separator":
            rows, height = 0, 6.0
        self.parts.append((rows, height + (0.0 if self.is_row else GAP_PX)))
        self.own_words.extend(self._words(name, values, named))
        return SimpleNamespace()

    @staticmethod
    def _words(name: str, values: tuple[Any, ...], named: dict[str, Any]) -> list[str]:
        if "text" in named:
            return [named["text"]]
        if name == "operator":
            return [rna_of(values[0]).name]
        return [values[0].bl_rna.properties[values[1]].name] if name == "prop" else []

    @property
    def rows(self) -> int:
        return int(self._total(0))

    @property
    def height(self) -> float:
        """Height of all of it [px]; a row is as high as its highest part."""
        return float(self.scale_y * self._total(1)) + (GAP_PX if self.is_row else 0.0)

    def _total(self, index: int) -> float:
        sizes = [(part.rows, part.height)[index] if isinstance(part, Sized) else part[index] for part in self.parts]
        return (max if self.is_row else sum)(sizes or [0.0])

    @property
    def words(self) -> list[str]:
        return [*self.own_words, *(word for part in self.parts if isinstance(part, Sized) for word in part.words)]


def context_of(width: int = 300) -> Any:
    """What a panel's draw() is given in a region of this width [px]."""
    return make_tab_context(bpy.context.scene, bpy.context.view_layer, width)


def drawn(panel: Any, width: int = 300) -> Recorder | None:
    """What the panel asks for now; None where its poll() hides it."""
    context = context_of(width)
    if hasattr(panel, "poll") and not panel.poll(context):
        return None
    recorder = Recorder()
    panel.draw(SimpleNamespace(layout=recorder, bl_rna=panel.bl_rna), context)
    return recorder
