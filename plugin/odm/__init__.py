"""Everything that knows ODM: camera ids, options, project folders, what it would do with a folder."""
