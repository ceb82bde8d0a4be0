"""Walking shader node trees: reroutes, muted nodes, links into and out of groups."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

GROUP_NODE = "ShaderNodeGroup"


class NodeGraph:
    """A material copy whose node groups are made its own, so that every node exists once and may be edited; or, with
    own_groups False, a material as it is, to read: a group used twice is then entered from one of its places."""

    def __init__(self, material: Any, copy_groups: bool = True) -> None:
        self.material = material
        self.tree = material.node_tree
        self._parent: dict[str, Any] = {}
        self._enter_groups(self.tree, copy_groups)

    @property
    def output(self) -> Any:
        """The Material Output that Cycles uses, or None."""
        return self.tree.get_output_node("CYCLES")

    def resolve(self, socket: Any) -> Any:
        """What feeds an input socket, through reroutes, muted nodes and group borders.

        The output socket that computes it, or the unlinked input socket whose default_value it is.
        """
        link = next((link for link in socket.links if not link.is_muted and link.is_valid), None)
        return socket if link is None else self._source(link.from_socket)

    def _source(self, output: Any) -> Any:
        node = output.node
        if node.mute:
            passed = next((link for link in node.internal_links if link.to_socket == output), None)
            return output if passed is None else self.resolve(passed.from_socket)
        if node.bl_idname == "NodeReroute":
            return self.resolve(node.inputs[0])
        if node.bl_idname == GROUP_NODE and node.node_tree is not None:
            inner = _find_group_output(node.node_tree)
            return output if inner is None else self.resolve(_find_matching_socket(inner.inputs, output))
        if node.bl_idname == "NodeGroupInput":
            parent = self._parent.get(output.id_data.name_full)
            return output if parent is None else self.resolve(_find_matching_socket(parent.inputs, output))
        return output

    def source_node(self, socket: Any) -> Any:
        """The node that computes an input socket, or None for a constant."""
        source = self.resolve(socket)
        return source.node if source.is_output and not source.node.mute else None

    def upstream(self, socket: Any, stop: frozenset[str] = frozenset()) -> Iterator[Any]:
        """Every node that socket depends on, each once; inputs of nodes whose bl_idname is in stop are not followed."""
        seen: set[tuple[str, str]] = set()
        waiting = [socket]
        while waiting:
            node = self.source_node(waiting.pop())
            if node is None or (key := (node.id_data.name_full, node.name)) in seen:
                continue
            seen.add(key)
            yield node
            if node.bl_idname not in stop:
                waiting.extend(node.inputs)

    def _enter_groups(self, tree: Any, copy_groups: bool) -> None:
        for node in tree.nodes:
            if node.bl_idname == GROUP_NODE and node.node_tree is not None:
                if copy_groups:
                    node.node_tree = node.node_tree.copy()
                self._parent[node.node_tree.name_full] = node
                self._enter_groups(node.node_tree, copy_groups)


def iter_nodes(tree: Any, visited: set[str] | None = None) -> Iterator[Any]:
    """Every node of a tree and of the groups in it."""
    visited = set() if visited is None else visited
    if tree is None or tree.name_full in visited:
        return
    visited.add(tree.name_full)
    for node in tree.nodes:
        yield node
        if getattr(node, "node_tree", None) is not None:
            yield from iter_nodes(node.node_tree, visited)


def _find_group_output(tree: Any) -> Any:
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), outputs[0] if outputs else None)


def _find_matching_socket(sockets: Any, socket: Any) -> Any:
    return next(other for other in sockets if other.identifier == socket.identifier)
