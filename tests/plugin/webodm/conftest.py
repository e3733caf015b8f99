"""``inside`` runs in a little WebODM of its own, started by ``test_server``; pytest outside of it stays out."""

collect_ignore = ["inside"]
