"""How the stages plug into a stack: the only place that knows ODM, NodeODM, pyodm, WebODM."""
