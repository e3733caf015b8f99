def get_objects_for_user(user, perm, model, accept_global_perms=False):
    return model.objects.all()
