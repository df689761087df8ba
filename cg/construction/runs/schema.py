"""Tables of a store."""

APPLICATION_ID = 0x63675247
"""Number in the header of an SQLite file that identifies stores of this package."""

VERSION = 2
"""Version of the tables, stored in the file; files of other versions are refused."""

TABLES = (
    """
    CREATE TABLE runs (
        number INTEGER PRIMARY KEY,
        kind TEXT NOT NULL,
        settings TEXT NOT NULL,
        versions TEXT NOT NULL,
        created REAL NOT NULL,
        changed REAL NOT NULL,
        owner TEXT,
        UNIQUE (kind, settings)
    )
    """,
    """
    CREATE TABLE starts (
        run INTEGER NOT NULL REFERENCES runs (number) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        stages INTEGER NOT NULL,
        flows INTEGER,
        tree TEXT,
        phase TEXT NOT NULL,
        f REAL NOT NULL,
        status INTEGER,
        evaluations INTEGER,
        refined_f REAL,
        refined_status INTEGER,
        refined_evaluations INTEGER,
        largest_residual REAL,
        solved INTEGER NOT NULL,
        coefficients BLOB NOT NULL,
        seconds REAL NOT NULL,
        finished REAL NOT NULL,
        PRIMARY KEY (run, number)
    )
    """,
    """
    CREATE TABLE failures (
        run INTEGER NOT NULL REFERENCES runs (number) ON DELETE CASCADE,
        number INTEGER NOT NULL,
        message TEXT NOT NULL,
        finished REAL NOT NULL,
        PRIMARY KEY (run, number)
    )
    """,
    "CREATE INDEX solved_starts ON starts (run, number) WHERE solved",
)
