/* Settings that the virtual camera lacks: image quality, focus mode, ISO. Included into vcamera.c,
 * before its table of properties. */
struct more { int code, size, count; unsigned int value, choices[4]; };
static struct more more_settings[] = {
	{0x5004, 1, 3, 2, {0, 1, 2}},           /* compression setting: imagequality */
	{0x500a, 2, 3, 1, {1, 0x8010, 0x8011}}, /* focus mode: manual, single, continuous */
	{0x500f, 2, 4, 200, {100, 200, 400, 800}}, /* exposure index: iso */
};

static int more_desc(struct more *m, PTPDevicePropDesc *desc) {
	int i;
	if (m->code == 0x500a && fault_is("autofocus")) m->value = 0x8010;
	desc->DevicePropertyCode = m->code;
	desc->DataType = m->size == 1 ? 2 : 4;
	desc->GetSet = 1;
	desc->FormFlag = 2;
	desc->FORM.Enum.NumberOfValues = m->count;
	desc->FORM.Enum.SupportedValue = calloc(m->count, sizeof(PTPPropertyValue));
	if (m->size == 1) {
		desc->FactoryDefaultValue.u8 = desc->CurrentValue.u8 = m->value;
		for (i = 0; i < m->count; i++) desc->FORM.Enum.SupportedValue[i].u8 = m->choices[i];
	} else {
		desc->FactoryDefaultValue.u16 = desc->CurrentValue.u16 = m->value;
		for (i = 0; i < m->count; i++) desc->FORM.Enum.SupportedValue[i].u16 = m->choices[i];
	}
	return 1;
}
static int more_get(struct more *m, PTPPropertyValue *val) {
	if (m->size == 1) val->u8 = m->value; else val->u16 = m->value;
	return 1;
}
static int more_set(struct more *m, PTPPropertyValue *val) {
	if (m->code == 0x500a && fault_is("autofocus")) return 1;
	m->value = m->size == 1 ? val->u8 : val->u16;
	return 1;
}
#define MORE(i) \
	static int more_desc_##i(vcamera *cam, PTPDevicePropDesc *d) { return more_desc(&more_settings[i], d); } \
	static int more_get_##i(vcamera *cam, PTPPropertyValue *v) { return more_get(&more_settings[i], v); } \
	static int more_set_##i(vcamera *cam, PTPPropertyValue *v) { return more_set(&more_settings[i], v); }
MORE(0) MORE(1) MORE(2)
#define MORE_PROPERTIES \
	{0x5004, more_desc_0, more_get_0, more_set_0}, \
	{0x500a, more_desc_1, more_get_1, more_set_1}, \
	{0x500f, more_desc_2, more_get_2, more_set_2},
