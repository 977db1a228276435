"""Record the rows of a registry as JSON, so that later versions can prove that they upgrade it: record.py URL FILE."""

import base64
import json
import sys
from datetime import date, datetime
from pathlib import Path

from sqlalchemy import MetaData, select

from softcal.db.schema.database import open_database


def _plain(value: object) -> object:
    if isinstance(value, bytes):
        return {"base64": base64.b64encode(value).decode()}
    return value.isoformat() if isinstance(value, (date, datetime)) else value


def main(url: str, path: Path) -> None:
    database = open_database(url, create=False)
    tables = MetaData()
    with database.reading() as connection:
        tables.reflect(connection)
        rows = {
            table.name: [{k: _plain(v) for k, v in row.items()} for row in connection.execute(select(table)).mappings()]
            for table in tables.sorted_tables
            if table.name != "alembic_version"
        }
    database.close()
    path.write_text(json.dumps({name: kept for name, kept in rows.items() if kept}, indent=1))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
