processed = []


class process_task:
    @staticmethod
    def delay(task_id):
        processed.append(str(task_id))
