"""YAML without references, by which a small file can stand for gigabytes."""

import yaml


class PlainLoader(yaml.SafeLoader):
    """Values only."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """One value; those inside it are composed by the same method."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("a reference (*name)")
        return super().compose_node(parent, index)
