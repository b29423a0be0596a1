/* hold TID: stops one thread of a process for ever; the other threads go on. */
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/ptrace.h>
#include <sys/wait.h>
#include <unistd.h>

int main(int argc, char **argv) {
	pid_t tid = argc > 1 ? atoi(argv[1]) : 0;
	if (ptrace(PTRACE_SEIZE, tid, 0, 0) || ptrace(PTRACE_INTERRUPT, tid, 0, 0)) {
		perror("hold");
		return 1;
	}
	while (kill(getpid(), 0) == 0) {
		int status;
		if (waitpid(tid, &status, __WALL) == tid && (WIFEXITED(status) || WIFSIGNALED(status)))
			return 0;
	}
	return 0;
}
