/* Added to libgphoto2's virtual camera when the harness builds it: a card that outlives the process,
 * faults on demand, and a few more camera settings. Nothing of it is linked into wingd.
 *
 * VCAMERADIR     the card: DCIM/ and one .jpg beside it (the camera's own code wants one to exist)
 * VCAMERA_SHOTS  directory with 00.jpg, 01.jpg, ..: what the lens sees, one after the other
 * VCAMERA_VIEWS  how many there are; after the last one the first again (default: no end)
 * VCAMERA_STATE  directory with `counter`, `log`, and `fault` (one word, written by the harness):
 *   press                        a picture is taken without a command, at once
 *   hang, die, truncate, stale   once, at the next shot; the file is removed when it strikes
 *   gone, full, busy, claimed, autofocus   for as long as the file is there
 */
#include <stdlib.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>
#include <sys/stat.h>

__attribute__((unused)) static const char *state_path(const char *name) {
	static char path[4096];
	const char *dir = getenv("VCAMERA_STATE");
	snprintf(path, sizeof(path), "%s/%s", dir ? dir : "/nonexistent", name);
	return path;
}

__attribute__((unused)) static int fault_is(const char *word) {
	char line[64] = "";
	FILE *file = fopen(state_path("fault"), "r");
	if (!file) return 0;
	if (!fgets(line, sizeof(line), file)) line[0] = 0;
	fclose(file);
	line[strcspn(line, "\n")] = 0;
	return !strcmp(line, word);
}

__attribute__((unused)) static void card_log(const char *what, const char *name) {
	FILE *file = fopen(state_path("log"), "a");
	if (!file) return;
	fprintf(file, "%s %s\n", what, name);
	fclose(file);
}

__attribute__((unused)) static int fault_once(const char *word) {
	if (!fault_is(word)) return 0;
	unlink(state_path("fault"));
	card_log("fault", word);
	return 1;
}

/* The number of shots so far; the virtual camera counts in twos. */
__attribute__((unused)) static int card_next(void) {
	int count = 98;
	FILE *file = fopen(state_path("counter"), "r");
	if (file) { if (fscanf(file, "%d", &count) != 1) count = 98; fclose(file); }
	file = fopen(state_path("counter"), "w");
	if (file) { fprintf(file, "%d\n", count + 2); fclose(file); }
	return count;
}

/* Copies the next view to the card as DIRECTORY/NAME; returns the file's path. */
__attribute__((unused)) static char *card_shot(const char *card, const char *directory, const char *name, int count) {
	static char from[4096], to[4096];
	static unsigned char block[65536];
	const char *shots = getenv("VCAMERA_SHOTS");
	long left = -1;
	size_t got;
	FILE *in, *out;
	int views = getenv("VCAMERA_VIEWS") ? atoi(getenv("VCAMERA_VIEWS")) : 0;
	int view = (count - 98) / 2;
	if (view > 0 && fault_once("stale")) view--;
	if (views > 0) view %= views;
	snprintf(from, sizeof(from), "%s/%02d.jpg", shots ? shots : "/nonexistent", view);
	snprintf(to, sizeof(to), "%s/DCIM/%s", card, directory);
	mkdir(to, 0755);
	snprintf(to, sizeof(to), "%s/DCIM/%s/%s", card, directory, name);
	in = fopen(from, "rb");
	out = fopen(to, "wb");
	if (in && out && fault_once("truncate")) { fseek(in, 0, SEEK_END); left = ftell(in) / 2; rewind(in); }
	while (in && out && left != 0 && (got = fread(block, 1, sizeof(block), in)) > 0) {
		if (left > 0 && (long)got > left) got = left;
		fwrite(block, 1, got, out);
		if (left > 0) left -= got;
	}
	if (in) fclose(in);
	if (out) fclose(out);
	card_log("shot", to);
	snprintf(to + sizeof(to) / 2, 3, "%02d", view);
	card_log("view", to + sizeof(to) / 2);
	return strdup(to);
}

/* A command is about to be written: the camera may hang for ever, or be gone. */
__attribute__((unused)) static int fault_write(const unsigned char *data, int bytes) {
	int capture = bytes >= 8 && data[4] == 1 && data[6] == 0x0e && data[7] == 0x10;
	if (capture && fault_once("hang"))
		for (;;) sleep(1000);
	return fault_is("gone");
}

/* An answer is about to be read: the camera may die in the middle of a picture. */
__attribute__((unused)) static int fault_read(int pending) {
	static int largest, dead;
	if (pending > largest) largest = pending;
	if (pending == 0) largest = 0;
	if (!dead && largest > 1000000 && pending < largest / 2 && fault_once("die")) dead = 1;
	return dead || fault_is("gone");
}

/* PTP response code with which a capture is refused; 0: it is not. */
__attribute__((unused)) static int fault_capture(void) {
	if (fault_is("full")) return 0x200C;
	if (fault_is("busy")) return 0x2019;
	return 0;
}
