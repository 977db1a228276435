"""The rules of a lot at the line, in versions: who set them, when and why."""

from sqlalchemy import select

from softcal.core.errors import InputError
from softcal.core.lot import Lot
from softcal.core.quality.line_rules import LineRules, rules_for
from softcal.db.entries import LineRulesEntry
from softcal.db.schema.tables import line_rules
from softcal.db.truth.registry_base import RegistryBase


class LineRulesTable(RegistryBase):
    """The part of the registry that knows the rules of lots at the line."""

    def line_rules(self, lot: Lot) -> LineRules:
        """Return the rules of a lot that hold now; where nobody set any, those that follow from the lot."""
        versions = self.line_rules_versions(lot.id)
        return versions[-1].rules if versions else rules_for(lot)

    def line_rules_versions(self, lot_id: str) -> list[LineRulesEntry]:
        """Return every version of a lot's rules, oldest first."""
        c = line_rules.c
        query = select(line_rules).where(c.lot_id == lot_id).order_by(c.made_at, c.origin)
        with self.database.reading() as connection:
            rows = connection.execute(query).mappings().all()
        return [
            LineRulesEntry(
                row["lot_id"], row["version"], LineRules(**row["rules"]), row["made_at"], row["actor"], row["reason"]
            )
            for row in rows
        ]

    def set_line_rules(
        self,
        lot_id: str,
        rules: LineRules,
        *,
        reason: str,
        actor: str | None = None,
        expected_version: int | None = None,
    ) -> LineRulesEntry:
        """Write the next version of a lot's rules.

        Args:
            expected_version: the version the change was decided on (0: none yet); None takes whatever is there.

        Raises:
            InputError: no reason, no such lot, or somebody else changed the rules since `expected_version`.
        """
        if not reason.strip():
            raise InputError("a change of the line's rules needs a reason; nothing was changed")
        with self.database.writing() as connection:
            self._lot_row(connection, lot_id)
            versions = self.line_rules_versions(lot_id)
            newest = versions[-1] if versions else None
            version = newest.version if newest else 0
            if newest is not None and expected_version not in (None, version):
                raise InputError(
                    f"the rules of lot {lot_id!r} were changed by {newest.actor} at "
                    f"{newest.made_at:%Y-%m-%d %H:%M} UTC; look at version {version} and decide again"
                )
            made_at = self._after(newest.made_at if newest else None)
            entry = LineRulesEntry(lot_id, version + 1, rules, made_at, self._actor(actor), reason)
            values = {**vars(entry), "rules": rules.settings(), "origin": self.origin}
            before = {"version": version, "rules": newest.rules.settings()} if newest else None
            self._store(connection, line_rules, values, "set_rules", actor, reason, before)
            return entry
